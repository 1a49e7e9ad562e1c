"""Runs the tests in the virtual machine, as root under systemd, and ends the machine with their verdict.

The tests in tests/vm run one after the other with nothing beside them, the others in several processes. To import
hyperbit takes half a minute on an emulated processor: this process imports it once and forks those that run tests. Each
test runs once: a second run would hide races.
"""

import importlib
import os
import subprocess
import sys
import tempfile
import time
from collections import Counter
from dataclasses import dataclass
from itertools import chain, groupby
from pathlib import Path
from shutil import which

import pytest

from tests.vm.boot import BASE
from tests.vm.prepare import ALONE, FOLDER, say

OPTIONS = ["-qq", "-p", "no:cacheprovider", "--timeout", "600", "--color=no"]
ON_CAN = ["--bus", "socketcan"]
WITHOUT_KERNELS = ["--noconftest"]  # tests/conftest.py imports them, for half a minute
PROCESSES = 3  # that share the tests outside of tests/vm
SLOW = ("test_processes.py", "test_kills.py", "test_faults.py", "test_setpoints.py")  # files that begin first
OUTCOMES = "outcomes"  # the name of files to which each test adds a line
INSTALLED = Path("/opt/hyperbit/versions")
VERDICT = Path("/dev/port"), 0xF4  # isa-debug-exit: QEMU ends with twice the byte that is written there, plus 1


@dataclass(frozen=True)
class Share:
    """A plugin by which several processes share tests: each process takes the next free file of tests.

    It reports every test as it ends, since a time-out may prevent a report at the end.

    Attributes:
        folder: common to the processes, which may run in several machines. It holds one folder for each file of tests
            that is taken, with the outcomes of its tests. Only one process can make it, and only that one writes there.
    """

    folder: Path

    def pytest_runtestloop(self, session: pytest.Session) -> bool:
        if session.testsfailed:
            raise session.Interrupted(f"{session.testsfailed} errors while tests were collected")
        files = [(path, list(tests)) for path, tests in groupby(session.items, lambda test: test.path)]
        files.sort(key=lambda file: file[0].name not in SLOW)
        mine = chain.from_iterable(tests for path, tests in files if self._take(path))
        test = next(mine, None)
        while test:
            following = next(mine, None)
            test.ihook.pytest_runtest_protocol(item=test, nextitem=following)
            test = following
        return True

    def _take(self, path: Path) -> bool:
        try:
            self._taken(path).mkdir()
        except FileExistsError:
            return False
        return True

    def _taken(self, path: Path) -> Path:
        return self.folder / f"{path.parent.name}-{path.name}"

    @pytest.hookimpl(tryfirst=True)
    def pytest_report_teststatus(self, report: pytest.TestReport) -> tuple[str, str, str]:
        return report.outcome, "", ""  # reported below

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        if report.when == "call" or report.outcome != "passed" or report.duration > 5:
            self._report(f"{report.outcome:7} {report.duration:4.0f} s {report.when:8} {report.nodeid}\n")
        if report.failed:
            self._report(f"{report.longreprtext}\n{report.caplog}\n{circumstances()}\n")
        if report.when == "call" or report.outcome != "passed":
            with (self._taken(Path(report.fspath)) / OUTCOMES).open("a") as ended:
                ended.write(f"{report.outcome}\n")

    def _report(self, text: str) -> None:
        os.write(sys.__stdout__.fileno(), text.encode())  # one write, so that lines of two processes do not mix


def circumstances() -> str:
    commands = ["journalctl --no-pager --lines 60 --unit hyperbit*", "ps -eo pcpu,time,args --sort -time --columns 120"]
    tools = [words.split() for words in commands]
    done = [subprocess.run(words, capture_output=True, text=True).stdout if which(words[0]) else "" for words in tools]
    return "\n".join([done[0], *done[1].splitlines()[:8]])


def run(processes: int, arguments: list[str], folder: Path) -> int:
    """Runs tests in several processes; returns the worst exit code of pytest.

    Args:
        folder: processes with the same folder share the tests, also those of other machines.
    """
    children = [fork(arguments, Share(folder)) for _ in range(processes)]
    codes = [os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) for child in children]
    return max((abs(code) for code in codes if code != pytest.ExitCode.NO_TESTS_COLLECTED), default=0)


def outcomes(folder: Path) -> str:
    counts = Counter(outcome for file in folder.glob(f"*/{OUTCOMES}") for outcome in file.read_text().split())
    return ", ".join(f"{count} {outcome}" for outcome, count in sorted(counts.items()))


def fork(arguments: list[str], share: Share) -> int:
    if child := os.fork():
        return child
    code = 70  # an internal error
    try:
        code = int(pytest.main(arguments, plugins=[share]))
    finally:
        os._exit(code)


def run_and_tell(processes: int, arguments: list[str]) -> int:
    begun = time.monotonic()
    with tempfile.TemporaryDirectory() as folder:
        code = run(processes, [*OPTIONS, *arguments], Path(folder))
        found = outcomes(Path(folder)) or "nothing to run"
    say(f"{found} in {time.monotonic() - begun:.0f} s by {processes} processes")
    return code


def compiled_since(begin: Path) -> list[Path]:
    """Returns the files of kernels that were compiled after a file was written."""
    kernels = chain(FOLDER.glob("cache/**/*.nbc"), INSTALLED.glob("**/*.nbc"))
    return [path for path in kernels if path.stat().st_mtime > begin.stat().st_mtime]


def main() -> None:
    system, processors = os.uname(), os.cpu_count()
    say(f"booted: {system.sysname} {system.release}, {processors} processors")
    arguments = (FOLDER / "arguments").read_text().splitlines()
    paths = [argument for argument in arguments if argument.startswith("tests")]
    options = [argument for argument in arguments if argument not in paths]
    alone = [path for path in paths if path.startswith(ALONE)]
    shared = [path for path in paths if path not in alone]
    codes = []
    if shared:
        importlib.import_module("tests.vm.compile")
        codes.append(run_and_tell(PROCESSES, [*ON_CAN, *options, *shared]))
    if alone:
        codes.append(run_and_tell(1, [*WITHOUT_KERNELS, *options, *alone]))
    for path in compiled_since(FOLDER / "arguments"):
        say(f"compiled here, which is slow: {path}")
    path, port = VERDICT
    with path.open("r+b", buffering=0) as ports:
        ports.seek(port)
        ports.write(bytes([BASE + max(codes)]))


if __name__ == "__main__":
    main()
