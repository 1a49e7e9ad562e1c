#!/bin/sh
# Installs hyperbit on a robot computer, in a virtual environment of its own under /opt/hyperbit, as a systemd service.
#
#   sudo deploy/install.sh [ARM.yaml]
#
# Run again to upgrade. Files in /etc/hyperbit and /etc/systemd/network are made where there are none, and then kept.
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
[ -r "$arm" ] || fail "$arm: no such file"

echo "installing into $prefix"
"$python" -m venv "$prefix"
"$prefix/bin/pip" install --quiet --upgrade "$project"
install -m 644 "$project/README.md" "$prefix/README.md"
ln -sf "$prefix/bin/hyperbit" /usr/local/bin/hyperbit

echo "checking $arm"
"$prefix/bin/hyperbit" check "$arm"

# keep SOURCE TARGET: installs a file that the operator may have changed only where there is none.
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
import sys, yaml
for group in yaml.safe_load(open(sys.argv[1], encoding="utf-8"))["modules"]:
    if "table" in group:
        print(group["table"])
' "$arm" | while IFS= read -r table; do
    install -D -m 644 "$(dirname "$arm")/$table" "/etc/hyperbit/$table"
    echo "wrote /etc/hyperbit/$table"
  done
else
  keep "$arm" /etc/hyperbit/arm.yaml
fi
keep "$project/deploy/zenoh.json5" /etc/hyperbit/zenoh.json5
keep "$project/deploy/can0.network" /etc/systemd/network/80-can0.network
keep "$project/deploy/can0.link" /etc/systemd/network/80-can0.link
install -D -m 644 "$project/deploy/hyperbit.service" /etc/systemd/system/hyperbit.service

systemctl daemon-reload
systemctl enable hyperbit.service
cat <<'TEXT'
Installed and enabled. Next:
  hyperbit check /etc/hyperbit/arm.yaml --bus     each board's answer
  systemctl restart systemd-networkd hyperbit     bring up can0 and start
  journalctl -u hyperbit -f                       what it says
  hyperbit watch /etc/hyperbit/arm.yaml           what the arm does
TEXT
