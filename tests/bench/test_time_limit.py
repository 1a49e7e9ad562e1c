"""The time limit of a block, in the main thread and in others, and that it ends with the block."""

from __future__ import annotations

import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from hyperbit.controller.bench import running
from hyperbit.controller.bench.running import TooLongError, at_most


def endless() -> None:
    while True:
        pass


def endless_numpy() -> None:
    values = np.ones(1000)
    while True:
        values = np.sqrt(values)


def caught(call: Callable[[], None], seconds: float = 0.02) -> bool:
    """Returns whether the limit has ended the call."""
    try:
        with at_most(seconds):
            call()
    except TooLongError:
        return True
    return False


@pytest.mark.parametrize("call", [endless, endless_numpy])
def test_a_loop_is_ended_in_each_thread(call):
    assert caught(call)
    with ThreadPoolExecutor(2) as pool:
        assert list(pool.map(caught, [call, call, call])) == [True] * 3


def test_a_block_in_time_and_its_own_exceptions_are_left_alone():
    assert not caught(lambda: None, 60)
    with pytest.raises(ZeroDivisionError), at_most(60):
        raise ZeroDivisionError
    timers = [each for each in threading.enumerate() if isinstance(each, threading.Timer)]
    assert not any(timer.function is running.set_exception for timer in timers)


def test_nothing_is_raised_after_the_block():
    """The limits end about when the blocks do."""
    leaked = 0
    for k in range(2000):
        caught(lambda: None, 2e-6 * (k % 100))
        try:
            sum(range(100))
        except TooLongError:
            leaked += 1
    assert leaked == 0


def test_an_exception_that_comes_too_late_is_taken_back(monkeypatch):
    """The timer acts while the block ends."""
    kinds = list[object]()

    class Late(threading.Timer):
        def cancel(self) -> None:
            """Does not cancel: the timer was just about to act."""

        def join(self, timeout: float | None = None) -> None:
            """Acts at the end of the wait."""
            self.function(*self.args)

    def recorded(thread: int, kind: type[BaseException] | None) -> None:
        kinds.append(kind)

    monkeypatch.setattr(running.threading, "Timer", Late)
    monkeypatch.setattr(running, "set_exception", recorded)
    with at_most(60):
        pass
    assert kinds == [TooLongError, None]
