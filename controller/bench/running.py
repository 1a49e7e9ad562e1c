"""Runs methods on goal sets, each goal under a time limit, and summarizes the outcomes."""

import ctypes
import gc
import threading
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import NamedTuple, cast

import numpy as np

from hyperbit.controller.arm.arm import Arm
from hyperbit.controller.bench.arm import BenchArm
from hyperbit.controller.bench.checking import Outcome, check
from hyperbit.controller.bench.goal_sets import Task, by_arm, load_arm
from hyperbit.controller.bench.methods import Prepare, Solve
from hyperbit.controller.library.goals import Goal
from hyperbit.controller.studies.shares import Run, Spread, alone

MISSES = ("missed", "touches", "nothing found")
PART = 8  # goals of a share


@dataclass(frozen=True)
class Row:
    """Summary of one method on one goal set. Counts are numbers of goals."""

    method: str
    goals: int  # that the method supports
    left_out: int  # that it does not support
    solved: int  # answers within the tolerances and collision-free
    missed: int  # answers outside the tolerances or in collision, or no answer
    fewest: int  # answers with the certified minimum of switches
    proven: int  # claims of optimality without contradiction
    wrong_certificates: int  # contradicted claims
    switches: float | None  # mean over the solved goals
    above: float | None  # mean above the certified optimum, over solved goals that have one
    above_most: int | None  # greatest number above the certified optimum
    seconds_median: float | None  # of the time for a goal
    seconds_99: float | None  # 99 % quantile of this time
    tables_seconds: float  # of `prepare` and the first goal of each arm, in the slowest worker
    errors: dict[str, int]  # number of goals by kind of error
    examples: list[str]  # a sentence for each kind of error, and for the first wrong certificate
    impossible: int  # answers with fewer switches than the proven minimum, so that the set is wrong


def run(name: str, prepare: Prepare, tasks: Sequence[Task], limit: float, spread: Spread = alone) -> Row:
    """Runs a method on goals; returns the summary. `limit` is for one goal [s]; `spread` solves PART goals a share."""
    outcomes, tables = dict[int, Outcome](), 0.0
    for arm, own in by_arm(list(tasks)).items():
        job = MethodJob(prepare, arm, load_arm(arm), own[0], limit)
        found: list[tuple[Outcome, float]] = list(spread(job, [own[k : k + PART] for k in range(0, len(own), PART)]))
        outcomes |= {id(task): outcome for task, (outcome, _) in zip(own, found, strict=True)}
        tables += max(seconds for _, seconds in found)
    return summed(name, tasks, [outcomes[id(task)] for task in tasks], tables)


def summed(name: str, tasks: Sequence[Task], outcomes: Sequence[Outcome], tables: float) -> Row:
    taken = [(k, task, o) for k, (task, o) in enumerate(zip(tasks, outcomes, strict=True)) if not o.left_out]
    served = [(task, o) for _, task, o in taken if o.solved]
    above = [o.switches - task.switches for task, o in served if task.proven]
    seconds = [o.seconds for _, _, o in taken]
    errors = Counter(o.kind for _, _, o in taken if o.kind and o.kind not in MISSES)
    examples: dict[str, str] = {}
    for k, _, o in taken:
        if o.kind in errors:
            examples.setdefault(o.kind, f"goal {k + 1}: {o.kind}: {o.detail}".rstrip(": "))
        if o.wrong:
            examples.setdefault("wrong", f"goal {k + 1}: {o.wrong}")
    return Row(
        method=name,
        goals=len(taken),
        left_out=len(tasks) - len(taken),
        solved=len(served),
        missed=sum(o.kind in MISSES for _, _, o in taken),
        fewest=sum(task.proven and o.switches == task.switches for task, o in served),
        proven=sum(o.proven for _, _, o in taken),
        wrong_certificates=sum(bool(o.wrong) for _, _, o in taken),
        switches=float(np.mean([o.switches for _, o in served])) if served else None,
        above=float(np.mean(above)) if above else None,
        above_most=max(above, default=None),
        seconds_median=float(np.median(seconds)) if seconds else None,
        seconds_99=float(np.quantile(seconds, 0.99)) if seconds else None,
        tables_seconds=tables,
        errors=dict(errors),
        examples=list(examples.values()),
        impossible=sum(o.switches < task.bound for task, o in served),
    )


class MethodJob(NamedTuple):
    """A method on an arm, for workers. A share is a sequence of goals.

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
