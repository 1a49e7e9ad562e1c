"""Real time, from the unit or the arm's file, with and without permission."""

import contextlib
import ctypes
import os
import resource
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest

from hyperbit.controller.armfile.settings import RealTimeSettings
from hyperbit.controller.executor.process.real_time import enter_real_time, raise_priority
from hyperbit.controller.host.scheduling import shorten_slice


def in_thread(work: Callable[[], Any]) -> Any:
    """Calls a function in a new thread, so that the test's thread keeps its scheduling policy."""
    with ThreadPoolExecutor(1) as pool:
        return pool.submit(work).result()


def policy() -> int:
    return os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK


def locked() -> int:
    """Locked memory [kB]."""
    (line,) = (line for line in Path("/proc/self/status").read_text().splitlines() if line.startswith("VmLck"))
    return int(line.split()[1])


def leave_real_time() -> None:
    ctypes.CDLL(None).munlockall()
    with contextlib.suppress(PermissionError):
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))


def test_nothing_is_asked_by_default() -> None:
    assert (enter_real_time(None), policy()) == ("off", os.SCHED_OTHER)


def test_short_turns_change_neither_policy_nor_niceness_and_leave_a_policy_that_was_chosen() -> None:
    def ask() -> None:
        before = os.sched_getscheduler(0), os.getpriority(os.PRIO_PROCESS, 0)
        shorten_slice()
        assert (os.sched_getscheduler(0), os.getpriority(os.PRIO_PROCESS, 0)) == before
        os.sched_setscheduler(0, os.SCHED_BATCH, os.sched_param(0))
        assert not shorten_slice()
        assert os.sched_getscheduler(0) == os.SCHED_BATCH

    in_thread(ask)


@pytest.mark.parametrize("by_unit", [False, True])
def test_the_process_goes_first_and_memory_is_locked(by_unit: bool) -> None:
    def work() -> int:
        if by_unit and raise_priority(7) is not None:
            pytest.skip("not permitted")
        status = enter_real_time(None if by_unit else RealTimeSettings(priority=7))
        try:
            if status != "on":
                pytest.skip(status)
            assert (policy(), os.sched_getparam(0).sched_priority) == (os.SCHED_FIFO, 7)
            assert locked() > 10_000
            return in_thread(policy)
        finally:
            leave_real_time()
            assert locked() < 10_000

    assert in_thread(work) == os.SCHED_OTHER, "a thread of it has no priority"


def test_missing_permissions_are_reported_and_the_executor_continues(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def refuse(*_: object) -> None:
        raise PermissionError(1, "Operation not permitted")

    monkeypatch.setattr(Path, "read_text", lambda _: "CapEff:\t0\n")
    monkeypatch.setattr(resource, "getrlimit", lambda _: (8 << 20, 8 << 20))
    monkeypatch.setattr(os, "sched_setscheduler", refuse)
    status = enter_real_time(RealTimeSettings())
    assert "SCHED_FIFO with priority 50 is not permitted: CPUSchedulingPolicy=fifo" in status
    assert "memory can be locked up to 8388608 bytes only: LimitMEMLOCK=infinity" in status
    assert len(caplog.records) == 2
