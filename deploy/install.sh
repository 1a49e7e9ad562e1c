#!/bin/sh
# Installs hyperbit on a robot computer, with two systemd services for each arm, executor and planner.
#
#   sudo deploy/install.sh [--without PART[,PART]] [ARM.yaml]   install or upgrade
#   sudo deploy/install.sh --switch                             use what was installed while services ran
#   sudo deploy/install.sh --back                               use the version before the present one
#
# The arm of the file becomes the services' instance `arm`. Parts are panel, pictures, recorder and ros2. In a folder that
# `make wheels` made, the script installs without an index.
#
# Each version has a virtual environment of its own in /opt/hyperbit/versions; the link /opt/hyperbit/current leads to the
# one in use. A version is complete before the link changes, so a failed installation leaves the present version in use.
# Existing files in /etc/hyperbit and /etc/systemd/network stay, and the counts of switches and the ledger in /var/lib.
set -eu
umask 022

here=$(cd "$(dirname "$0")" && pwd -P)
prefix=/opt/hyperbit
python=${PYTHON:-python3}
units=/etc/systemd/system
catalog=/usr/local/lib/systemd/catalog/hyperbit.catalog
space=1000 # MB of free disk that an installation needs, most of it for a while

fail() {
  echo "install: $1" >&2
  exit 1
}

# -- What is asked ----------------------------------------------------------------------------------------------------

task=install without='' given=''
while [ $# -gt 0 ]; do
  case $1 in
    --switch | --back) task=${1#--} ;;
    --without)
      [ $# -gt 1 ] || fail "--without needs parts: panel, pictures, recorder or ros2, with commas"
      without=$(echo "$2" | tr ',' ' ')
      shift
      ;;
    -*) fail "$1: no such option; there are --without PARTS, --switch and --back" ;;
    *)
      [ -z "$given" ] || fail "two files of an arm, $given and $1: give one; others are instances, see README.md"
      given=$1
      ;;
  esac
  shift
done
for part in $without; do
  case $part in panel | pictures | recorder | ros2) ;; *) fail "$part: no such part; there are panel, pictures, recorder and ros2" ;; esac
done
[ "$task" = install ] || [ -z "$without$given" ] || fail "--$task takes neither parts nor a file: the version has them"
[ -z "$given" ] || [ -f "$given" ] || fail "$given: no such file"

# -- What this computer has -------------------------------------------------------------------------------------------

[ "$(id -u)" = 0 ] || fail "run it as root: sudo $0"
command -v systemctl >/dev/null || fail "there is no systemd on this computer"
command -v systemd-sysusers >/dev/null || fail "systemd-sysusers is missing: apt install systemd"
exec 9>/run/lock/hyperbit-install
flock -n 9 || fail "another installation runs"
unset PYTHONPATH PYTHONHOME NUMBA_CACHE_DIR

# version LINK: prints the folder to which a link leads, or nothing. Up to version 0.3 there was no link.
version() {
  if [ -e "$prefix/$1/bin/hyperbit" ]; then
    readlink -f "$prefix/$1"
  elif [ "$1" = current ] && [ -e "$prefix/pyvenv.cfg" ]; then
    echo "$prefix"
  fi
}

# sweep: removes the versions to which no link leads.
sweep() {
  for folder in "$prefix"/versions/*; do
    case $folder in "$(version current)" | "$(version previous)" | "$(version next)" | "$prefix/versions/*") ;; *)
      rm -rf "$folder"
      echo "removed $folder"
      ;;
    esac
  done
}

# point LINK FOLDER: makes a link lead to a folder, in one step.
point() {
  ln -sfn "versions/${2##*/}" "$prefix/$1.new"
  mv -T "$prefix/$1.new" "$prefix/$1"
}

# -- A version of its own ---------------------------------------------------------------------------------------------

if [ "$task" = install ]; then
  command -v "$python" >/dev/null || fail "$python is missing: apt install python3 python3-venv"
  "$python" -c 'import sys; sys.exit(not (3, 11) <= sys.version_info < (3, 14))' ||
    fail "Python 3.11, 3.12 or 3.13 is needed, for which the locked versions have wheels; $python is $("$python" --version)"
  "$python" -c 'import sys; sys.exit(sys.maxsize < 2**32)' || fail "$python has 32 bits, for which numba has no wheels"
  "$python" -c 'import ensurepip' 2>/dev/null || fail "Python cannot make virtual environments: apt install python3-venv"
  wheel=$(find "$here" -maxdepth 1 -name 'hyperbit-*.whl')
  [ -n "$wheel" ] || [ -f "$here/../pyproject.toml" ] ||
    fail "$here is neither in a clone of hyperbit nor a folder of: make wheels"
  mkdir -p "$prefix/versions"
  rm -f "$prefix/next"
  sweep
  free=$(df -Pk "$prefix/versions" | awk 'NR == 2 { print int($4 / 1024) }')
  [ "$free" -ge "$space" ] || fail "$prefix has $free MB of free disk, and an installation needs $space MB"
  if [ -n "$wheel" ]; then
    package=$wheel number=${wheel##*/hyperbit-} number=${number%%-*}
    set -- --no-index --find-links "$here"
    export PIP_CONFIG_FILE=/dev/null
  else
    package=$(dirname "$here")
    set --
    number=$(sed -n 's/^version = "\(.*\)"$/\1/p' "$package/pyproject.toml")
    rm -rf "$package/build/lib" # the build would add its files
  fi
  target=$prefix/versions/$number count=1
  while [ -e "$target" ]; do
    count=$((count + 1))
    target=$prefix/versions/$number-$count
  done

  trap 'rm -rf "$target"; echo "install: failed; no service has changed, and ${present:-no version} is in use" >&2' EXIT
  trap 'exit 1' HUP INT TERM
  present=$(version current)
  # Running services have priority, for the processor and for memory.
  renice -n 19 $$ >/dev/null
  echo 1000 >/proc/$$/oom_score_adj

  echo "installing into $target"
  "$python" -m venv "$target"
  mkdir "$target/tmp" "$target/units"
  export TMPDIR="$target/tmp" # /tmp may be small, and in memory
  # A line of the lock ends with the parts that need the package; without parts all need it.
  awk -v "without= $without " '{
    kept = NF == 1
    for (k = 3; k <= NF; k++) kept = kept || !index(without, " " $k " ")
    if (kept) print
  }' "$here/versions.txt" >"$target/versions.txt"
  "$target/bin/pip" install --quiet --disable-pip-version-check --no-cache-dir --no-deps --only-binary :all: "$@" \
    --requirement "$target/versions.txt" "$package" ||
    fail "pip failed, see above. This computer: $(uname -m), $("$python" --version), clock at $(date)"
  (cd "$target" && ln -s lib/python3*/site-packages/hyperbit doc)
  echo "compiling kernels, which takes minutes"
  "$target/bin/python" -P -m hyperbit.controller.host.kernels
  for unit in "$target"/doc/deploy/*.service; do
    part=${unit##*/hyperbit-}
    case " $without " in *" ${part%.service} "*) ;; *) cp "$unit" "$target/units" ;; esac
  done
  cp "$target/doc/deploy/hyperbit.catalog" "$target/units"
  rm -r "$target/tmp"
  unset TMPDIR
elif [ "$task" = back ]; then
  target=$(version previous)
  [ -n "$target" ] || fail "there is no earlier version in $prefix/versions"
else
  target=$(version next)
  if [ -z "$target" ]; then
    echo "nothing waits: $(version current) is in use"
    exit
  fi
fi

# Running programs import modules late, and must not find another version's. The operator decides when the boards may lose
# their heartbeat.
running=$(systemctl list-units --plain --no-legend --state=active,activating,reloading,deactivating 'hyperbit*.service' \
  2>/dev/null | cut -d ' ' -f 1 | tr '\n' ' ')
stop="systemctl stop $running; the boards then do what on_loss says"
[ "$task" = install ] || [ -z "$running" ] || fail "services are running: $stop"

# -- Its arms ---------------------------------------------------------------------------------------------------------

arm=$target/doc/deploy/planar16.yaml
[ ! -e /etc/hyperbit/arm.yaml ] || arm=/etc/hyperbit/arm.yaml
[ ! -e "$target/arm/arm.yaml" ] || arm=$target/arm/arm.yaml
arm=${given:-$arm}
echo "checking $arm"
"$target/bin/hyperbit" check "$arm" || fail "$target refuses this arm, see above"
for enabled in "$units"/multi-user.target.wants/hyperbit@*.service; do
  name=${enabled##*/hyperbit@} name=${name%.service}
  case $name in arm | '*') continue ;; esac
  "$target/bin/hyperbit" check "/etc/hyperbit/$name.yaml" || fail "$target refuses this arm, see above"
done
if [ -n "$given" ]; then
  install -D -m 644 "$given" "$target/arm/arm.yaml"
  "$target/bin/python" -P -c '
import sys
from pathlib import Path
from hyperbit.controller.armfile.settings import files_beside, read_settings
sys.stdout.writelines(f"{name}\n" for name in files_beside(read_settings(Path(sys.argv[1]))[0]))
' "$given" | while IFS= read -r table; do
    install -D -m 644 "$(dirname "$given")/$table" "$target/arm/$table"
  done
fi
if [ "$task" = install ]; then
  point next "$target"
  trap - EXIT
fi

if [ -n "$running" ]; then
  echo "$target is complete, and $(version current) stays in use, because services run. Next: $stop"
  echo "Then: sudo sh $target/doc/deploy/install.sh --switch"
  exit
fi

# -- The switch -------------------------------------------------------------------------------------------------------

trap '' HUP INT TERM

# Up to version 0.3 one arm had services without an instance. They go, and what they kept becomes that of the instance.
if [ -e "$units/hyperbit.service" ]; then
  # move FROM TO: moves what is there, unless TO exists.
  move() {
    if [ -e "$1" ] && [ ! -e "$2" ]; then
      mkdir -p "$(dirname "$2")"
      mv "$1" "$2"
      echo "moved $1 to $2"
    fi
  }
  move /var/lib/private/hyperbit /var/lib/private/hyperbit-arms/arm/planner
  move /var/lib/private/hyperbit-executor /var/lib/private/hyperbit-arms/arm/executor
  move /etc/hyperbit/zenoh.json5 /etc/hyperbit/arm.json5
  [ ! -e /etc/hyperbit/arm.json5 ] || sed -i 's#/hyperbit.service/#/hyperbit@arm.service/#' /etc/hyperbit/arm.json5
  for service in hyperbit hyperbit-executor; do
    rm -f "/var/lib/$service" "/var/cache/$service"
    [ ! -d "$units/$service.service.d" ] ||
      echo "Warning: $service.service.d has no effect any more: write it again by: systemctl edit $service@arm"
  done
  # Kernels and maps are computed again. Version 0.1 left a link to a folder that this version cannot use.
  rm -rf /var/cache/private/hyperbit /run/hyperbit
fi

# keep SOURCE TARGET: installs a file, unless TARGET exists: the operator may have changed it.
keep() {
  if [ -e "$2" ]; then
    echo "kept $2"
  else
    install -D -m 644 "$1" "$2.new"
    mv "$2.new" "$2"
    echo "wrote $2"
  fi
}

if [ "$task" != back ]; then
  if [ -d "$target/arm" ]; then
    mkdir -p /etc/hyperbit
    cp -R "$target/arm/." /etc/hyperbit
    rm -r "$target/arm"
    echo "wrote /etc/hyperbit/arm.yaml"
  else
    keep "$arm" /etc/hyperbit/arm.yaml
  fi
  keep "$target/doc/deploy/zenoh.json5" /etc/hyperbit/arm.json5
  keep "$target/doc/deploy/zenoh-router.json5" /etc/hyperbit/zenoh-router.json5
  # One file for each bus of the arm, with its bit rate.
  "$target/bin/python" -P -c '
import sys
from pathlib import Path
from hyperbit.controller.armfile.settings import read_settings
for bus in read_settings(Path(sys.argv[1]))[0].buses:
    if bus.interface == "socketcan":
        print(bus.channel, bus.bitrate)
' /etc/hyperbit/arm.yaml | while read -r channel bitrate; do
    network=/etc/systemd/network/80-$channel.network
    [ ! -e "$network" ] || grep -qx "BitRate=$bitrate" "$network" ||
      echo "Warning: $network has not the bit rate of the arm, $bitrate: change it, or remove it and run this again"
    sed "s/^Name=.*/Name=$channel/; s/^BitRate=.*/BitRate=$bitrate/" "$target/doc/deploy/can0.network" >"$target/bus.network"
    keep "$target/bus.network" "$network"
  done
  keep "$target/doc/deploy/can0.link" /etc/systemd/network/80-can0.link
  # A static group: by it the planner's user and operators may open the executor's socket.
  systemd-sysusers --inline 'g hyperbit -'
fi
for unit in "$target"/units/*.service; do
  install -m 644 "$unit" "$units/${unit##*/}.new"
done

# Up to version 0.3 the virtual environment was /opt/hyperbit itself. It gets a folder and its units, and its commands get
# the new path. pyvenv.cfg moves last: an interrupted move goes on when this is run again.
if [ -e "$prefix/pyvenv.cfg" ]; then
  old=$prefix/versions/0.3
  mkdir -p "$old/units"
  for unit in "$target"/units/*.service; do
    [ ! -e "$units/${unit##*/}" ] || cp "$units/${unit##*/}" "$old/units"
  done
  [ ! -e "$catalog" ] || cp "$catalog" "$old/units"
  for part in bin include lib64 lib share doc bus.network pyvenv.cfg; do
    if [ -e "$prefix/$part" ] || [ -L "$prefix/$part" ]; then
      mv "$prefix/$part" "$old"
    fi
  done
  find "$old/bin" -type f -exec sed -i "s#$prefix/bin#$old/bin#" {} +
  rm -rf /var/cache/private/hyperbit-arms/*/numba # kernels of programs at the former path
  # There is no way back to services without instances: their ledger and counts have moved.
  [ -e "$units/hyperbit.service" ] || point current "$old"
fi

present=$(version current)
[ -z "$present" ] || [ "$present" = "$target" ] || point previous "$present"
point current "$target"
rm -f "$prefix/next"
ln -sfn current/bin "$prefix/bin"
ln -sfn current/doc "$prefix/doc"
ln -sf "$prefix/bin/hyperbit" /usr/local/bin/hyperbit
# Services that the present version has and the other one has not.
if [ -e "$units/hyperbit.service" ]; then
  systemctl disable hyperbit.service
  rm -f "$units/hyperbit.service" "$units/hyperbit-executor.service"
fi
for unit in "${present:-$target}"/units/*.service; do
  if [ ! -e "$target/units/${unit##*/}" ]; then
    systemctl disable "${unit##*/}"
    rm -f "$units/${unit##*/}"
  fi
done
for unit in "$target"/units/*.service; do
  mv "$units/${unit##*/}.new" "$units/${unit##*/}"
done
# Explanations for `journalctl -x`.
[ ! -e "$target/units/hyperbit.catalog" ] || install -D -m 644 "$target/units/hyperbit.catalog" "$catalog"
journalctl --update-catalog
systemctl daemon-reload
[ "$task" = back ] || systemctl enable hyperbit@arm.service
sweep
echo "$target is in use"
if [ -n "$present" ]; then
  echo "Next: systemctl start hyperbit@arm"
  echo "The way back to $present: sudo sh $here/install.sh --back"
  exit
fi
cat <<'TEXT'
Next:
  systemctl restart systemd-networkd                     bring up can0
  hyperbit check /etc/hyperbit/arm.yaml --bus            read each board
  systemctl start hyperbit@arm                           start planner and executor
  journalctl -f -u 'hyperbit*'                           read their messages
  hyperbit watch /etc/hyperbit/arm.yaml                  watch the arm
  systemctl start hyperbit-panel                         serve the operator's page, see README.md
  systemctl start hyperbit-recorder                      record the arm into /var/lib/hyperbit-recorder
  systemctl start hyperbit-ros2                          show the arm to a ROS 2 system, see README.md
  systemctl start hyperbit-router                        connect a cell's arms, see fleet.md
  usermod --append --groups hyperbit USER                let USER run `hyperbit halt`
TEXT
