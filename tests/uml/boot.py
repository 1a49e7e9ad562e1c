"""Runs tests on vcan in machines of user-mode Linux, as ordinary processes without rights, and ends with their verdict.

python -m tests.uml.boot [arguments of pytest]

Without paths of tests among the arguments, `tests/system` runs, but for tests that are marked for other buses. Each
machine has one processor, and runs one test at a time. The machines share the files of tests.
"""

import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from tests.uml.prepare import BEYOND_AMX, FOLDER, KERNEL, amx, prepare
from tests.vm.guest import outcomes
from tests.vm.prepare import PROJECT, Missing

COMMON = FOLDER / "common"  # which the machines write to
MACHINES = 2 * len(os.sched_getaffinity(0))  # because many tests wait
MEMORY = 2  # [GiB], of each machine
LONGEST = 7200.0  # [s]


def boot(number: int) -> subprocess.Popen[bytes]:
    memory = Path("/dev/shm")
    if not memory.is_dir() or shutil.disk_usage(memory).free < MEMORY * MACHINES << 30:
        memory = FOLDER
    environment = {"HOME": str(FOLDER), "TMPDIR": str(memory)}
    if amx():
        environment["LD_PRELOAD"] = str(BEYOND_AMX)
    root = ["root=/dev/root", "rootfstype=hostfs", "rootflags=/", "ro", f"init={Path(__file__).parent / 'init'}"]
    command = [str(KERNEL), f"mem={MEMORY}G", *root, "con=null", "con0=null,fd:1", "quiet"]
    command += ["--", str(PROJECT), str(number)]
    return subprocess.Popen(command, env=environment, stdin=subprocess.DEVNULL, start_new_session=True)


def run(arguments: list[str]) -> int:
    """Runs the tests; returns the worst of pytest's exit codes, or 124 or 125 if a machine gave none."""
    shutil.rmtree(COMMON, ignore_errors=True)
    COMMON.mkdir(parents=True)
    (COMMON / "arguments").write_text("\n".join(arguments))
    begun = time.monotonic()
    machines: list[subprocess.Popen[bytes]] = []
    try:
        machines += [boot(number) for number in range(MACHINES)]
        for machine in machines:
            machine.wait(max(0.0, begun + LONGEST - time.monotonic()))
    except subprocess.TimeoutExpired:
        say(f"the machines were not done after {LONGEST:g} s")
        return 124
    finally:
        for machine in machines:
            if machine.poll() is None:
                os.killpg(machine.pid, signal.SIGKILL)
    found = outcomes(COMMON)
    say(f"{found or 'no test ran'} in {time.monotonic() - begun:.0f} s by {MACHINES} machines")
    verdicts = [COMMON / f"verdict-{number}" for number in range(MACHINES)]
    if silent := [verdict.name for verdict in verdicts if not verdict.exists()]:
        say(f"no {', '.join(silent)}: the lines above tell why a machine ended")
        return 125
    return max(int(verdict.read_text()) for verdict in verdicts) or (0 if found else pytest.ExitCode.NO_TESTS_COLLECTED)


def say(what: str) -> None:
    print(f"vcan-test: {what}", flush=True)


def main() -> int:
    arguments = sys.argv[1:]
    if not any(argument.startswith("tests") for argument in arguments):
        arguments.append("tests/system")
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))  # ends the machines, too
    say("preparing the kernel and the caches of compiled code")
    try:
        prepare()
    except Missing as error:
        say(f"cannot run: {error}")
        return 2
    return run(arguments)


if __name__ == "__main__":
    sys.exit(main())
