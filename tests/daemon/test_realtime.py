"""What is asked of the system for the control loop, given or not."""

import os
import resource
import threading
from collections.abc import Callable
from pathlib import Path

import pytest

from controller.daemon import realtime
from controller.daemon.realtime import RealTime
from controller.settings import RealTimeSettings


def in_thread(work: Callable[[], None]) -> None:
    """Does it in a thread of its own, whose policy is not the test's."""
    failures: list[BaseException] = []

    def guarded() -> None:
        try:
            work()
        except BaseException as error:
            failures.append(error)

    thread = threading.Thread(target=guarded)
    thread.start()
    thread.join()
    if failures:
        raise failures[0]


def policy() -> int:
    return os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK


def locked() -> int:
    """Locked memory [kB]."""
    (line,) = (line for line in Path("/proc/self/status").read_text().splitlines() if line.startswith("VmLck"))
    return int(line.split()[1])


def test_nothing_is_asked_by_default() -> None:
    with RealTime(None) as real_time:
        assert (real_time.status, policy()) == ("off", os.SCHED_OTHER)


def test_only_the_calling_thread_goes_first_and_memory_is_locked() -> None:
    def work() -> None:
        with RealTime(RealTimeSettings(priority=7)) as real_time:
            if real_time.status != "on":
                pytest.skip(real_time.status)
            assert (policy(), os.sched_getparam(0).sched_priority) == (os.SCHED_FIFO, 7)
            in_thread(lambda: policies.append(policy()))
            assert locked() > 10_000
        assert policy() == os.SCHED_OTHER
        assert locked() < 10_000

    policies: list[int] = []
    in_thread(work)
    assert policies == [os.SCHED_OTHER]


def test_what_is_not_permitted_is_said_and_gone_without(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def refuse(*_: object) -> None:
        raise PermissionError(1, "Operation not permitted")

    monkeypatch.setattr(realtime, "may_lock_all", lambda: False)
    monkeypatch.setattr(resource, "getrlimit", lambda _: (8 << 20, 8 << 20))
    monkeypatch.setattr(os, "sched_setscheduler", refuse)
    real_time = RealTime(RealTimeSettings())
    with real_time:
        assert "SCHED_FIFO with priority 50 is not permitted: LimitRTPRIO=50" in real_time.status
        assert "memory can be locked up to 8388608 bytes only: LimitMEMLOCK=infinity" in real_time.status
        assert locked() < 10_000
    assert len(caplog.records) == 2
