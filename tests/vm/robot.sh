#!/bin/sh
# robot.sh FOLDER WHEELS: installs hyperbit as on a robot's computer, over a version of one service, then upgrades it, and
# keeps in FOLDER the files that this writes. Run it in namespaces of its own for mounts and network (unshare --mount --net):
# nothing of this computer changes, and there is no network.
set -eu
layer=$1
wheels=$2
project=$(cd "$(dirname "$0")/../.." && pwd)

memory=$layer.memory
mkdir -p "$memory"
mount -t tmpfs tmpfs "$memory"
for folder in etc opt usr/local var/lib var/cache; do
  mkdir -p "$memory/files/$folder" "$memory/work/$folder"
  mount -t overlay -o "lowerdir=/$folder,upperdir=$memory/files/$folder,workdir=$memory/work/$folder" overlay "/$folder"
done

# What the version of one service left: its unit, and a ledger of its transient user.
mkdir -p -m 700 /var/lib/private /var/lib/private/hyperbit
cat > /etc/systemd/system/hyperbit.service << 'UNIT'
[Service]
ExecStart=/opt/hyperbit/bin/hyperbit run /etc/hyperbit/arm.yaml --zenoh /etc/hyperbit/zenoh.json5
DynamicUser=yes
StateDirectory=hyperbit
RuntimeDirectory=hyperbit
RuntimeDirectoryPreserve=restart
UNIT
python3 -c '
import os, sqlite3, sys
with sqlite3.connect(sys.argv[1]) as ledger:
    ledger.executescript("""
CREATE TABLE switches (actuator TEXT PRIMARY KEY, count INTEGER NOT NULL);
CREATE TABLE goals (
  number INTEGER PRIMARY KEY, id TEXT NOT NULL, accepted REAL NOT NULL, waypoints INTEGER NOT NULL,
  ended REAL, status TEXT, code INTEGER, message TEXT, switches INTEGER
);
""")
    ledger.execute("INSERT INTO switches VALUES (?, ?)", ("1.left", 1000))
    ledger.execute("INSERT INTO goals VALUES (1, ?, 1e9, 1, 1e9, ?, 0, ?, 1000)", ("old", "succeeded", ""))
ledger.close()
os.chown(sys.argv[1], 61999, 61999)
' /var/lib/private/hyperbit/planar16.sqlite
chown 61999:61999 /var/lib/private/hyperbit
ln -s private/hyperbit /var/lib/hyperbit

# What the version of two services left: it was enabled, and had a folder of counts, a Zenoh configuration and a drop-in.
mkdir -p /etc/hyperbit /etc/systemd/system/multi-user.target.wants /etc/systemd/system/hyperbit.service.d
ln -s ../hyperbit.service /etc/systemd/system/multi-user.target.wants/hyperbit.service
cp /etc/systemd/system/hyperbit.service /etc/systemd/system/hyperbit-executor.service
mkdir -m 700 /var/lib/private/hyperbit-executor
touch /var/lib/private/hyperbit-executor/other.switches
{ echo '// /run/credentials/hyperbit.service/hyperbit.ca.pem'; cat "$project/deploy/zenoh.json5"; } > /etc/hyperbit/zenoh.json5

arm=$memory/arm.yaml # with two buses
sed 's/^  - {name: can0, .*/  - {name: can0, channel: can0, bitrate: 500000}\n  - {name: can1, channel: can1, bitrate: 250000}/' \
  "$project/deploy/planar16.yaml" > "$arm"
export PATH=/usr/sbin:/usr/bin:/sbin:/bin SYSTEMD_OFFLINE=1 NUMBA_CPU_NAME=generic # kernels for any processor
NUMBA_DISABLE_JIT=1 "$wheels/install.sh" "$arm" # without kernels

# Up to version 0.3 the virtual environment was /opt/hyperbit itself, without kernels.
cd /opt/hyperbit
first=$(readlink -f current)
rm -r bin doc current "$first/doc" "$first/units" "$first/versions.txt"
mv "$first"/* .
rm -r versions
find bin -type f -exec sed -i "s#$first/bin#$PWD/bin#" {} +
cd "$project"
"$wheels/install.sh"

# Six times the units' own times, as the tests' times.
for service in hyperbit@ hyperbit-executor@; do mkdir "/etc/systemd/system/$service.service.d"; done
cat > /etc/systemd/system/hyperbit@.service.d/emulated.conf << 'UNIT'
[Service]
Environment=NUMBA_CPU_NAME=generic
WatchdogSec=60
TimeoutStopSec=90
UNIT
cat > /etc/systemd/system/hyperbit-executor@.service.d/emulated.conf << 'UNIT'
[Service]
WatchdogSec=12
TimeoutStopSec=90
UNIT

rm -rf "$layer"
cp -a "$memory/files" "$layer"
