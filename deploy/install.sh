#!/bin/sh
# Installs hyperbit on a robot computer: a virtual environment under /opt/hyperbit and two systemd services for each arm,
# executor and planner. The arm of the file becomes their instance `arm`.
#
#   sudo deploy/install.sh [ARM.yaml]
#
# Run it again to upgrade, also from versions whose services had no instances. It keeps existing files in /etc/hyperbit and
# /etc/systemd/network, and the counts of switches and the ledger in /var/lib.
set -eu

project=$(cd "$(dirname "$0")/.." && pwd)
arm=${1:-$project/deploy/planar16.yaml}
prefix=/opt/hyperbit
python=${PYTHON:-python3}

fail() {
  echo "install: $1" >&2
  exit 1
}

[ "$(id -u)" = 0 ] || fail "run it as root: sudo $0 $*"
command -v systemctl >/dev/null || fail "there is no systemd on this computer"
command -v "$python" >/dev/null || fail "$python is missing: apt install python3 python3-venv"
"$python" -c 'import sys; sys.exit(sys.version_info < (3, 11))' || fail "Python 3.11 or newer is needed, $python is older"
"$python" -c 'import ensurepip' 2>/dev/null || fail "Python cannot make virtual environments: apt install python3-venv"
command -v systemd-sysusers >/dev/null || fail "systemd-sysusers is missing: apt install systemd"
[ -r "$arm" ] || fail "$arm: no such file"
# A running program imports modules late and must not find another version's modules. The operator decides when the boards
# may lose their heartbeat.
running=$(systemctl list-units --plain --no-legend --state=active,activating,reloading,deactivating 'hyperbit*.service' \
  2>/dev/null | cut -d ' ' -f 1 | tr '\n' ' ')
[ -z "$running" ] || fail "services are running: systemctl stop $running; the boards then do what on_loss says"

echo "installing into $prefix"
"$python" -m venv "$prefix"
"$prefix/bin/pip" install --quiet --upgrade --constraint "$project/deploy/versions.txt" \
  "${project}[panel,pictures,recorder,ros2]"
# numba cannot load kernels compiled from another version. The first start compiles them again.
rm -rf /var/cache/private/hyperbit-arms/*/numba
rm -rf "$prefix/README.md" "$prefix/doc"
(cd "$project" && find README.md controller deploy drivers tests -name '*.md') | while IFS= read -r page; do
  install -D -m 644 "$project/$page" "$prefix/doc/$page"
done
ln -sf "$prefix/bin/hyperbit" /usr/local/bin/hyperbit

echo "checking $arm"
"$prefix/bin/hyperbit" check "$arm"

# Up to version 0.3 one arm had services without an instance. They go, and what they kept becomes that of the instance.
if [ -e /etc/systemd/system/hyperbit.service ]; then
  systemctl disable hyperbit.service
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
    rm -f "/etc/systemd/system/$service.service" "/var/lib/$service" "/var/cache/$service"
    [ ! -d "/etc/systemd/system/$service.service.d" ] ||
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
    install -D -m 644 "$1" "$2"
    echo "wrote $2"
  fi
}

if [ $# -gt 0 ]; then
  install -D -m 644 "$arm" /etc/hyperbit/arm.yaml
  echo "wrote /etc/hyperbit/arm.yaml"
  "$prefix/bin/python" -c '
import sys
from pathlib import Path
from hyperbit.controller.armfile.settings import files_beside, read_settings
sys.stdout.writelines(f"{name}\n" for name in files_beside(read_settings(Path(sys.argv[1]))[0]))
' "$arm" | while IFS= read -r table; do
    install -D -m 644 "$(dirname "$arm")/$table" "/etc/hyperbit/$table"
    echo "wrote /etc/hyperbit/$table"
  done
else
  keep "$arm" /etc/hyperbit/arm.yaml
fi
keep "$project/deploy/zenoh.json5" /etc/hyperbit/arm.json5
keep "$project/deploy/zenoh-router.json5" /etc/hyperbit/zenoh-router.json5
# One file for each bus of the arm, with its bit rate.
"$prefix/bin/python" -c '
import sys
from pathlib import Path
from hyperbit.controller.armfile.settings import read_settings
for bus in read_settings(Path(sys.argv[1]))[0].buses:
    if bus.interface == "socketcan":
        print(bus.channel, bus.bitrate)
' "$arm" | while read -r channel bitrate; do
  target=/etc/systemd/network/80-$channel.network
  [ ! -e "$target" ] || grep -qx "BitRate=$bitrate" "$target" ||
    echo "Warning: $target has not the bit rate of $arm, $bitrate: change it, or remove it and run this again"
  sed "s/^Name=.*/Name=$channel/; s/^BitRate=.*/BitRate=$bitrate/" "$project/deploy/can0.network" >"$prefix/bus.network"
  keep "$prefix/bus.network" "$target"
done
keep "$project/deploy/can0.link" /etc/systemd/network/80-can0.link
# A static group: by it the planner's user and operators may open the executor's socket.
systemd-sysusers --inline 'g hyperbit -'
for service in hyperbit@ hyperbit-executor@ hyperbit-panel hyperbit-recorder hyperbit-ros2 hyperbit-router; do
  install -D -m 644 "$project/deploy/$service.service" "/etc/systemd/system/$service.service"
done
# Explanations for `journalctl -x`.
install -D -m 644 "$project/deploy/hyperbit.catalog" /usr/local/lib/systemd/catalog/hyperbit.catalog
journalctl --update-catalog

systemctl daemon-reload
systemctl enable hyperbit@arm.service
cat <<'TEXT'
Installed and enabled. Next:
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
