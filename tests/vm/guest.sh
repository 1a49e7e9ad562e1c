#!/bin/sh
# In the virtual machine, as root under systemd: runs the tests and ends the machine with their verdict.
cd "$(dirname "$0")/../.." || exit
export HOME=/root PATH=/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin LANG=C.UTF-8
export PYTHONUNBUFFERED=1 OPENBLAS_NUM_THREADS=1 OMP_NUM_THREADS=1
export XDG_CACHE_HOME="$PWD/build/vm/cache" NUMBA_CACHE_DIR="$PWD/build/vm/cache/numba" NUMBA_CPU_NAME=generic
export HYPERBIT_SLOWNESS=6
ip link set lo up
mountpoint -q /dev/shm || mount -t tmpfs -o mode=1777 tmpfs /dev/shm

echo "booted: $(uname -sr), $(nproc --all) processors, clock $(cat /sys/devices/system/clocksource/clocksource0/current_clocksource)"
. build/vm/arguments

# What needs the machine for itself comes last. A test that fails is tried once more, with nothing beside it: that a
# processor that is emulated was late is no failure. Both are told.
try() {
  .venv/bin/python -m pytest -o cache_dir=/tmp/tried -p tests.vm.live --bus socketcan --timeout 600 --color=no -vv "$@"
}
verdict=0
for which in "not alone" alone; do
  case $which in alone) processes=0 ;; *) processes=2 ;; esac
  try --durations 15 --numprocesses $processes --dist worksteal "$@" -m "$which"
  code=$?
  if [ $code = 1 ]; then
    echo "once more, what failed:"
    try --last-failed --last-failed-no-failures none "$@" -m "$which"
    code=$?
  fi
  [ $code = 5 ] || [ $code = 0 ] || verdict=$code # 5: none of them was asked for
  rm -rf /tmp/tried
done
find build/vm/cache /var/cache/private/hyperbit/numba -name '*.nbc' -newer build/vm/arguments \
  -exec echo "compiled here, which is slow:" {} \;

# isa-debug-exit: QEMU ends with twice the byte written to port f4h, plus 1.
printf "\\$(printf %o $((16 + verdict)))" | dd of=/dev/port bs=1 seek=244 status=none
