"""Runs the tests in several processes, forked after one collection: pytest --forks 5 --forks-beside 4.

Each process takes the next portion of tests as soon as it is free. A process that dies fails the test that it ran. One
whose test outlasts every time-out is killed. What the tests left running is killed at the end.
"""

from __future__ import annotations

import contextlib
import ctypes
import io
import os
import signal
import threading
import time
from collections.abc import Iterator
from itertools import chain, groupby, pairwise
from multiprocessing import connection
from pathlib import Path
from typing import Any

import pytest

PORTION = 16  # tests that a process takes at once
NICE = 10
HUNG = 900.0  # [s] that no test takes, for its time-out is shorter
REAPED_EVERY = 0.1  # [s]; tests wait for the end of orphans
PR_SET_CHILD_SUBREAPER = 36  # prctl(2): orphans of the tests become children of this process


def pytest_addoption(parser: pytest.Parser) -> None:
    group = parser.getgroup("forks")
    group.addoption("--forks", type=int, default=0, help="number of processes that run tests")
    group.addoption(
        "--forks-beside", type=int, default=0, help="number of processes for tests in real time, which wait"
    )


@pytest.hookimpl(tryfirst=True)
def pytest_runtestloop(session: pytest.Session) -> bool | None:
    options = session.config.option
    if not options.forks or options.collectonly or session.testsfailed:
        return None
    waiting = [item for item in session.items if item.get_closest_marker("real_time")]
    computing = [item for item in session.items if not item.get_closest_marker("real_time")]
    queues = [Queue(waiting, whole_files=True), Queue(computing, whole_files=False)]
    ctypes.CDLL(None).prctl(PR_SET_CHILD_SUBREAPER, 1, 0, 0, 0)
    running: dict[connection.Connection, int] = {}
    try:
        for number in range(options.forks + options.forks_beside):
            computes = number >= options.forks_beside > 0  # without others beside them, all take all tests
            receiver, sender = connection.Pipe(duplex=False)
            child = os.fork()
            if child == 0:
                run_tests(session, queues[computes:], sender)
                return True
            sender.close()
            running[receiver] = child
        receive_reports(session, running)
    finally:
        kill_children()
    return True


class Queue:
    """Portions of tests. Each is taken by one of the processes."""

    def __init__(self, items: list[pytest.Item], whole_files: bool) -> None:
        self._portions: list[list[pytest.Item]] = []
        for _, group in groupby(items, lambda item: item.path):
            tests = list(group)
            size = len(tests) if whole_files else PORTION
            self._portions += [tests[k : k + size] for k in range(0, len(tests), size)]
        self.real_time = whole_files
        self._next, numbers = os.pipe()
        os.write(numbers, b"".join(k.to_bytes(2) for k in range(len(self._portions))))
        os.close(numbers)

    def take(self) -> Iterator[pytest.Item]:
        while number := os.read(self._next, 2):
            yield from self._portions[int.from_bytes(number)]


def run_tests(session: pytest.Session, queues: list[Queue], sender: connection.Connection) -> None:
    """Runs the tests of the queues in this process, and sends what becomes of them."""
    config = session.config
    config.workerinput = {}  # type: ignore[attr-defined]  # the parent keeps the cache of failed tests
    plugins = config.pluginmanager
    plugins.unregister(name="terminalreporter")
    silent = pytest.TerminalReporter(config, io.StringIO())
    silent.pytest_sessionstart(session)
    plugins.register(silent, "terminalreporter")
    plugins.register(Sender(config, sender))
    capture: Any = plugins.getplugin("capturemanager")
    capture.stop_global_capturing()
    capture.start_global_capturing()
    for item, following in pairwise(chain(taken(queues), [None])):
        assert item is not None
        sender.send(item.nodeid)
        config.hook.pytest_runtest_protocol(item=item, nextitem=following)
        if session.shouldstop or session.shouldfail:
            break
    sender.send(None)


def taken(queues: list[Queue]) -> Iterator[pytest.Item]:
    for queue in queues:
        if not queue.real_time:
            os.nice(NICE)
        yield from queue.take()


class Sender:
    """Sends each report to the parent."""

    def __init__(self, config: pytest.Config, sender: connection.Connection) -> None:
        self._config, self._sender = config, sender

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        self._sender.send(self._config.hook.pytest_report_to_serializable(config=self._config, report=report))


def receive_reports(session: pytest.Session, running: dict[connection.Connection, int]) -> None:
    """Passes reports of the processes on, until all have ended."""
    hook, at = session.config.hook, dict.fromkeys(running, ("no test", time.monotonic()))
    while running:
        for receiver, child in running.items():
            if time.monotonic() > at[receiver][1] + HUNG:
                os.kill(child, signal.SIGKILL)
        for receiver in connection.wait(list(running), REAPED_EVERY):
            assert isinstance(receiver, connection.Connection)
            try:
                message = receiver.recv()
            except EOFError:
                message = hook.pytest_report_to_serializable(config=session.config, report=died(at[receiver][0]))
                del running[receiver]
            if message is None:
                del running[receiver]
            elif isinstance(message, str):
                at[receiver] = message, time.monotonic()
            else:
                report = hook.pytest_report_from_serializable(config=session.config, data=message)
                hook.pytest_runtest_logreport(report=report)
        if session.shouldfail:
            raise session.Failed(session.shouldfail)
        with contextlib.suppress(ChildProcessError):
            while os.waitpid(-1, os.WNOHANG)[0]:
                pass


def died(nodeid: str) -> pytest.TestReport:
    return pytest.TestReport(nodeid, (nodeid, None, ""), {}, "failed", "the process of this test died", "call")


def kill_children() -> None:
    """Kills the children of this process, and the orphans of these, until none is left."""
    with contextlib.suppress(ChildProcessError):
        while True:
            children = Path(f"/proc/self/task/{threading.get_native_id()}/children").read_text().split()
            for child in children:
                os.kill(int(child), signal.SIGKILL)
            os.waitpid(-1, 0)
