#!/bin/sh
# robot.sh FOLDER: installs hyperbit as on a robot's computer and keeps in FOLDER what that writes.
# To be run in a mount namespace of its own (unshare --mount), where this computer's folders only seem to change.
set -eu
layer=$1
project=$(cd "$(dirname "$0")/../.." && pwd)

memory=$layer.memory
mkdir -p "$memory"
mount -t tmpfs tmpfs "$memory"
for folder in etc opt usr/local; do
  mkdir -p "$memory/files/$folder" "$memory/work/$folder"
  mount -t overlay -o "lowerdir=/$folder,upperdir=$memory/files/$folder,workdir=$memory/work/$folder" overlay "/$folder"
done
# The first start compiles for minutes where the processor is emulated: that is done here, for any processor.
mkdir -p -m 700 "$memory/files/var/cache/private"
export NUMBA_CPU_NAME=generic NUMBA_CACHE_DIR="$memory/files/var/cache/private/hyperbit/numba"
rm -rf "$project/build/lib" # what was built before must not be installed again
PATH=/usr/sbin:/usr/bin:/sbin:/bin SYSTEMD_OFFLINE=1 "$project/deploy/install.sh"
/opt/hyperbit/bin/python -P "$project/tests/vm/compile.py"
mkdir /etc/systemd/system/hyperbit.service.d
cat > /etc/systemd/system/hyperbit.service.d/emulated.conf << 'UNIT'
[Service]
Environment=NUMBA_CPU_NAME=generic
# Six times the unit's own, as the tests' times.
WatchdogSec=12
TimeoutStopSec=90
UNIT

rm -rf "$layer"
cp -a "$memory/files" "$layer"
