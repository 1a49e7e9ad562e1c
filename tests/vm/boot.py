"""Boots the virtual machine, prints the reports of its tests, and ends with their verdict.

python -m tests.vm.boot [--essential] [arguments of pytest]

Without paths of tests among the arguments, `tests/vm` and `tests/system` run; with `--essential` only those of every
check.
"""

import signal
import subprocess
import sys

from tests.vm.prepare import ALONE, FOLDER, PROJECT, TESTS, Missing, prepare, say

ESSENTIAL = [ALONE, "-k", "not clock and not interface and not certificates and not beside"]
LONGEST = 3600.0  # [s]
BASE = 16  # added by the guest to pytest's exit code, to tell it from QEMU's own

# A processor whose clock counts its instructions, 1 ns each: on a busy computer the machine's time runs slower,
# and no test fails for that. It has no AVX: QEMU 7.2 emulates parts of AVX wrongly, and NumPy's argsort crashed.
QEMU = [
    *("qemu-system-x86_64", "-accel", "tcg,thread=single", "-icount", "shift=0,sleep=on", "-rtc", "clock=vm"),
    *("-smp", "1", "-cpu", "Nehalem", "-m", "4G"),
    *("-nodefaults", "-display", "none", "-serial", "stdio", "-no-reboot"),
    *("-device", "virtio-rng-pci", "-device", "isa-debug-exit,iobase=0xf4,iosize=1"),
    *("-kernel", str(FOLDER / "vmlinuz"), "-initrd", str(FOLDER / "initrd")),
]
KERNEL = "console=ttyS0 loglevel=3 panic=-1 mitigations=off fstab=no apparmor=0 audit=0 tsc=reliable clocksource=tsc"
# Without timers: a clock that is set an hour forward would start Debian's daily jobs.
SYSTEMD = "systemd.show_status=no systemd.unit=tests-of-hyperbit.service systemd.mask=timers.target"


def share(tag: str, path: str) -> list[str]:
    folder = f"local,id={tag},path={path},security_model=none,readonly=on,multidevs=remap"
    return ["-fsdev", folder, "-device", f"virtio-9p-pci,fsdev={tag},mount_tag={tag}"]


def boot(arguments: list[str]) -> int:
    """Runs the tests in the machine; returns pytest's exit code, or 124 or 125 if there was no verdict."""
    (FOLDER / "arguments").write_text("\n".join(arguments))
    shares = share("root", "/") + share("robot", str(FOLDER / "robot"))
    command = [*QEMU, *shares, "-append", f"{KERNEL} {SYSTEMD} hyperbit={PROJECT}"]
    with subprocess.Popen(command, stdin=subprocess.DEVNULL) as machine:
        try:
            code = machine.wait(LONGEST)
        except subprocess.TimeoutExpired:
            say(f"the machine was not done after {LONGEST:g} s")
            return 124
        finally:
            machine.kill()
    if code % 2 == 0 or code >> 1 < BASE:
        say(f"the machine ended without a verdict, QEMU with {code}")
        return 125
    return (code >> 1) - BASE


def main() -> int:
    arguments = [argument for argument in sys.argv[1:] if argument != "--essential"]
    if not any(argument.startswith("tests") for argument in arguments):
        arguments += ESSENTIAL if "--essential" in sys.argv else TESTS
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))  # ends the machine, too
    try:
        prepare([argument for argument in arguments if argument.startswith("tests")])
    except Missing as error:
        say(f"cannot run: {error}")
        return 2
    say("booting")
    return boot(arguments)


if __name__ == "__main__":
    sys.exit(main())
