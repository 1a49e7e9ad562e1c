"""The signals that end a process in order, on processes of their own."""

import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from hyperbit.controller.host.signals import ENDING, OF_TERMINAL
from tests.waiting import PATIENCE

ROOT = Path(__file__).parents[2]
COUNTING = """
from hyperbit.controller.host import signals
ends = []
signals.end_on_signals(lambda: ends.append(1))
print("ready", flush=True)
for line in sys.stdin:
    print(len(ends), flush=True)
"""
CLOSING = """
from hyperbit.controller.host import signals
signals.exit_on_signals()
try:
    print("ready", flush=True)
    time.sleep(3600)
finally:
    os.kill(os.getpid(), signal.SIGHUP)
    os.kill(os.getpid(), signal.SIGTERM)
    print("closed", flush=True)
"""
IN_CALLBACK = """
import ctypes
from hyperbit.controller.host import signals
signals.exit_on_signals()
print("ready", flush=True)
sys.stdin.readline()
ctypes.CFUNCTYPE(None)(lambda: os.kill(os.getpid(), signal.SIGTERM))()  # C has no place for an exception of Python
time.sleep(3600)
"""
IGNORING = """
from hyperbit.controller.host import signals
signals.ignore(signals.ENDING)
print("ready", flush=True)
for line in sys.stdin:
    print("here", flush=True)
"""
Start = Callable[..., subprocess.Popen[str]]


@pytest.fixture
def start() -> Iterator[Start]:
    """Runs a script in a process of its own, with SIGHUP ignored or not, until it is ready."""
    started: list[subprocess.Popen[str]] = []

    def run(script: str, *, nohup: bool = False) -> subprocess.Popen[str]:
        hang_up = "SIG_IGN" if nohup else "SIG_DFL"
        begin = f"import os, signal, sys, time\nsignal.signal(signal.SIGHUP, signal.{hang_up})\n"
        process = subprocess.Popen(
            [sys.executable, "-c", begin + script],
            cwd=ROOT, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
        )  # fmt: skip
        started.append(process)
        assert said(process) == "ready"
        return process

    yield run
    for process in started:
        process.kill()
        process.communicate()


def said(process: subprocess.Popen[str]) -> str:
    assert process.stdout
    return process.stdout.readline().strip()


def after(process: subprocess.Popen[str], *numbers: signal.Signals) -> str:
    """What a process says after signals. A pending signal is handled before the line is read."""
    assert process.stdin
    for number in numbers:
        process.send_signal(number)
    process.stdin.write("\n")
    process.stdin.flush()
    return said(process)


def test_a_terminal_sends_no_signal_that_ends_no_process() -> None:
    assert set(OF_TERMINAL) < set(ENDING)


@pytest.mark.parametrize("number", ENDING)
def test_each_signal_asks_for_the_end(start: Start, number: signal.Signals) -> None:
    assert after(start(COUNTING), number) == "1"


@pytest.mark.parametrize("first", ENDING)
def test_a_further_hang_up_asks_for_nothing(start: Start, first: signal.Signals) -> None:
    process = start(COUNTING)
    assert after(process, first) == "1"
    assert after(process, signal.SIGHUP) == "1"
    assert after(process, signal.SIGTERM) == "2"


def test_an_ignored_hang_up_stays_ignored(start: Start) -> None:
    process = start(COUNTING, nohup=True)
    assert after(process, signal.SIGHUP) == "0"
    assert after(process, signal.SIGTERM) == "1"


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
def test_a_command_closes_what_is_open_and_a_second_signal_does_not_interrupt_this(
    start: Start, number: signal.Signals
) -> None:
    process = start(CLOSING)
    process.send_signal(number)
    assert said(process) == "closed"
    assert process.wait(PATIENCE) == 128 + number


def test_a_command_whose_hang_up_is_ignored_ends_by_sigterm(start: Start) -> None:
    process = start(CLOSING, nohup=True)
    process.send_signal(signal.SIGHUP)
    process.send_signal(signal.SIGTERM)
    assert said(process) == "closed"
    assert process.wait(PATIENCE) == 128 + signal.SIGTERM


def test_ignored_signals_end_nothing(start: Start) -> None:
    assert after(start(IGNORING), *ENDING) == "here"


def test_a_signal_within_a_callback_of_c_ends_the_process(start: Start) -> None:
    process = start(IN_CALLBACK)
    process.stdin.write("\n")  # type: ignore[union-attr]
    process.stdin.flush()  # type: ignore[union-attr]
    assert process.wait(PATIENCE) == 128 + signal.SIGTERM


ANY_LINE = """
import itertools, sys, threading
from hyperbit.controller.host.signals import Ending
for at in itertools.count():
    ending, lines = Ending(), itertools.count()
    def trace(frame, event, _):
        if event == "line" and next(lines) == at:
            ending.set()
        return trace
    def wait():
        sys.settrace(trace)
        ending.wait(0.01)
    waiting = threading.Thread(target=wait, daemon=True)
    waiting.start()
    waiting.join(60.0)
    assert not waiting.is_alive(), f"a signal at line {at} of the wait holds it for ever"
    if not ending.is_set():
        break
assert at > 2
"""


def test_a_signal_may_come_at_any_line_of_a_wait_for_the_end() -> None:
    """A handler runs between two lines of `wait`, or of what `wait` calls; in a process that traces nothing else."""
    done = subprocess.run([sys.executable, "-c", ANY_LINE], stderr=subprocess.PIPE, text=True, check=False)
    assert done.returncode == 0, done.stderr
