"""One method on one arm, as a job whose shares are goals: a worker prepares, solves, measures and checks."""

import ctypes
import gc
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import NamedTuple, cast

import numpy as np

from hyperbit.controller.arm.arm import Arm
from hyperbit.controller.bench.arm import BenchArm
from hyperbit.controller.bench.checking import Outcome, check
from hyperbit.controller.bench.goal_sets import Task
from hyperbit.controller.bench.methods import Prepare, Solve
from hyperbit.controller.library.goals import Goal
from hyperbit.controller.studies.shares import Run


class MethodJob(NamedTuple):
    """A method on an arm. A share is a sequence of goals.

    `first` is solved once before all others, so that no goal waits for tables. `limit` is for one goal [s].
    """

    method: Prepare
    arm: str
    model: Arm
    first: Task
    limit: float

    def prepare(self) -> Run:
        """Prepares the method; outcomes come with the time of `prepare` and of the first goal [s]."""
        arm = BenchArm(self.arm, self.model)
        began = time.perf_counter()
        solve, outcome = prepared(self.method, arm, self.first, self.limit)
        tables = time.perf_counter() - began

        def run(tasks: Sequence[Task]) -> Iterator[tuple[Outcome, float]]:
            for task in tasks:
                yield outcome or solved(solve, arm, task, self.limit), tables

        return run


def prepared(prepare: Prepare, arm: BenchArm, first: Task, limit: float) -> tuple[Solve, Outcome | None]:
    """Prepares a method for an arm and solves one goal; returns `solve`, or the outcome of all goals if it failed."""

    def nothing(goal: Goal, start: np.ndarray) -> None: ...

    try:
        solve = prepare(arm)
    except NotImplementedError:
        return nothing, Outcome(False, 0, 0.0, left_out=True)
    except (Exception, SystemExit) as error:
        return nothing, raised(error, 0.0)
    if not callable(cast(object, solve)):
        return nothing, Outcome(False, 0, 0.0, kind="no function", detail=f"the method returned {solve!r:.60}")
    solved(solve, arm, first, 10 * limit)
    return solve, None


def solved(solve: Solve, arm: BenchArm, task: Task, limit: float) -> Outcome:
    """Solves a goal and checks the answer. The method receives copies; its exceptions become outcomes."""
    goal = Goal(task.position, task.angle, task.tolerance, None if task.angle is None else task.angle_tolerance)
    start = task.start.copy()
    gc.disable()
    began = time.perf_counter()
    try:
        with at_most(limit):
            began = time.perf_counter()  # again: the limit itself takes 0.1 ms
            answer = solve(goal, start)
            seconds = time.perf_counter() - began
    except NotImplementedError:
        return Outcome(False, 0, 0.0, left_out=True)
    except TooLongError:
        return Outcome(False, 0, limit, kind="took too long", detail=f"more than {limit:g} s")
    except (Exception, SystemExit) as error:
        return raised(error, time.perf_counter() - began)
    finally:
        gc.enable()
    return check(arm, task, answer, seconds)


def raised(error: BaseException, seconds: float) -> Outcome:
    text = " ".join(str(error).split())
    return Outcome(False, 0, seconds, kind=f"raised {type(error).__name__}", detail=text[:200])


class TooLongError(BaseException):
    """A method took too long for a goal. It is no Exception, so that a method does not catch it by accident."""


@contextmanager
def at_most(seconds: float) -> Iterator[None]:
    """Raises TooLongError in the block after a time [s], at the next Python code of this thread.

    A call that waits, or computes outside Python, ends first. Nothing is raised after the end of the block.
    """
    thread = threading.get_ident()
    timer = threading.Timer(seconds, set_exception, (thread, TooLongError))
    timer.daemon = True
    timer.start()
    try:
        yield
    finally:
        timer.cancel()
        timer.join()
        set_exception(thread, None)  # the timer may have set one that is not raised yet


def set_exception(thread: int, kind: type[BaseException] | None) -> None:
    """Makes a thread raise an exception at its next Python code; None: cancels one that it has not raised yet."""
    given = None if kind is None else ctypes.py_object(kind)
    ctypes.pythonapi.PyThreadState_SetAsyncExc(ctypes.c_ulong(thread), given)
