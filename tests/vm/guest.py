"""In the virtual machine, as root under systemd: runs the tests and ends the machine with their verdict.

To import what they need takes half a minute on an emulated processor: that is done once, and every process that runs
tests is forked from this one.
"""

import os
import subprocess
import sys
import tempfile
import time
from collections import Counter
from dataclasses import dataclass
from itertools import chain, groupby
from pathlib import Path

import pytest

import tests.vm.compile  # noqa: F401 all of hyperbit
from tests.vm.boot import BASE
from tests.vm.prepare import FOLDER, PROJECT, say

OPTIONS = ["-qq", "-p", "no:cacheprovider", "--bus", "socketcan", "--timeout", "600", "--color=no"]
VERDICT = Path("/dev/port"), 0xF4  # of isa-debug-exit: QEMU ends with twice the byte that is written there, plus 1


@dataclass(frozen=True)
class Share:
    """A plugin by which several processes share tests: each runs the next file that no other one took.

    It tells of every test as it ends, not when all have ended, which a time-out may prevent.

    Attributes:
        folder: which the processes have in common.
    """

    folder: Path

    def pytest_runtestloop(self, session: pytest.Session) -> bool:
        if session.testsfailed:
            raise session.Interrupted(f"{session.testsfailed} errors while tests were collected")
        files = groupby(session.items, lambda test: test.path)
        mine = chain.from_iterable(list(tests) for path, tests in files if self._take(path))
        test = next(mine, None)
        while test:
            following = next(mine, None)
            test.ihook.pytest_runtest_protocol(item=test, nextitem=following)
            test = following
        return True

    def _take(self, path: Path) -> bool:
        try:
            (self.folder / f"{path.parent.name}-{path.name}").touch(exist_ok=False)
        except FileExistsError:
            return False
        return True

    @pytest.hookimpl(tryfirst=True)
    def pytest_report_teststatus(self, report: pytest.TestReport) -> tuple[str, str, str]:
        return report.outcome, "", ""  # told below

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        if report.when == "call" or report.outcome != "passed" or report.duration > 5:
            self._tell(f"{report.outcome:7} {report.duration:4.0f} s {report.when:8} {report.nodeid}\n")
        if report.failed:
            self._tell(f"{report.longreprtext}\n{report.caplog}\n{circumstances()}\n")
        if report.when == "call" or report.outcome != "passed":
            with (self.folder / "outcomes").open("a") as outcomes:
                outcomes.write(f"{report.outcome} {report.nodeid}\n")

    def _tell(self, what: str) -> None:
        os.write(sys.__stdout__.fileno(), what.encode())  # at once, not between the lines of another process


def circumstances() -> str:
    """What else went on."""
    commands = ["journalctl --no-pager --lines 60", "ps -eo pcpu,time,args --sort -time --columns 120"]
    done = [subprocess.run(words.split(), capture_output=True, text=True).stdout for words in commands]
    return "\n".join([done[0], *done[1].splitlines()[:8]])


def run(processes: int, arguments: list[str], again: bool = False) -> tuple[int, list[str]]:
    """Runs tests.

    Args:
        processes: how many share them.
        arguments: of pytest.
        again: whether some of them failed: that an emulated processor was late once is no failure.

    Returns:
        Worst exit code of pytest, and which tests failed.
    """
    if again:
        say("what failed, once more and with nothing beside it")
    begun = time.monotonic()
    with tempfile.TemporaryDirectory() as name:
        share = Share(Path(name))
        children = [fork([*OPTIONS, *arguments], share) for _ in range(processes)]
        codes = [os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) for child in children]
        told = share.folder / "outcomes"
        outcomes = [line.split(" ", 1) for line in told.read_text().splitlines()] if told.exists() else []
    counts = Counter(outcome for outcome, _ in outcomes)
    found = ", ".join(f"{count} {outcome}" for outcome, count in sorted(counts.items())) or "nothing to run"
    say(f"{found} in {time.monotonic() - begun:.0f} s by {processes} processes")
    nothing = pytest.ExitCode.NO_TESTS_COLLECTED
    return max((abs(code) for code in codes if code != nothing), default=0), [
        name for outcome, name in outcomes if outcome == "failed"
    ]


def fork(arguments: list[str], share: Share) -> int:
    """Runs pytest in a new process and returns that."""
    if child := os.fork():
        return child
    code = 70  # an internal error
    try:
        code = int(pytest.main(arguments, plugins=[share]))
    finally:
        os._exit(code)


def main() -> None:
    system, processors = os.uname(), os.cpu_count()
    say(f"booted: {system.sysname} {system.release}, {processors} processors")
    arguments = (FOLDER / "arguments").read_text().splitlines()
    code, failed = run(3, [*arguments, "-m", "not alone"])
    if code == pytest.ExitCode.TESTS_FAILED:
        code, _ = run(1, [*failed, "-m", "not alone"], again=True)
    service, _ = run(1, [*arguments, "-m", "alone"])
    if service == pytest.ExitCode.TESTS_FAILED:  # all of them, as each finds what the one before it left
        service, _ = run(1, [*arguments, "-m", "alone"], again=True)
    for path in FOLDER.glob("cache/**/*.nbc"):
        if path.stat().st_mtime > (FOLDER / "arguments").stat().st_mtime:
            say(f"compiled here, which is slow: {path.relative_to(PROJECT)}")
    path, port = VERDICT
    with path.open("r+b", buffering=0) as ports:
        ports.seek(port)
        ports.write(bytes([BASE + max(code, service)]))


if __name__ == "__main__":
    main()
