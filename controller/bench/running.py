"""Runs methods on goal sets and summarizes the outcomes."""

import gc
import time
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import cast

import numpy as np

from controller.bench.arm import BenchArm
from controller.bench.checking import Outcome, check
from controller.bench.goal_sets import Task, by_arm
from controller.bench.methods import Prepare, Solve
from controller.bench.time_limit import TooLongError, at_most
from controller.library.goals import Goal

MISSES = ("missed", "touches", "nothing found")


@dataclass(frozen=True)
class Row:
    """Summary of one method on one goal set. Counts are numbers of goals.

    Attributes:
        method: name of the method.
        goals: goals that the method supports.
        left_out: goals that the method does not support.
        solved: answers within the tolerances and collision-free.
        missed: answers outside the tolerances or in collision, or no answer.
        fewest: answers with the certified minimum of switches.
        proven: answers that the method claims to be optimal, without contradiction.
        wrong_certificates: contradicted claims.
        switches: mean number of switches over the solved goals.
        above: mean number of switches above the certified optimum, over solved goals that have one.
        above_most: greatest number of switches above the certified optimum.
        seconds_median: median time for a goal [s].
        seconds_99: 99 % quantile of the time for a goal [s].
        tables_seconds: time of `prepare` and of the first goal of each arm, which is then solved again [s].
        errors: number of goals by kind of error.
        examples: a sentence for each kind of error, and for the first wrong certificate.
        impossible: answers with fewer switches than the proven minimum, so that the set is wrong.
    """

    method: str
    goals: int
    left_out: int
    solved: int
    missed: int
    fewest: int
    proven: int
    wrong_certificates: int
    switches: float | None
    above: float | None
    above_most: int | None
    seconds_median: float | None
    seconds_99: float | None
    tables_seconds: float
    errors: dict[str, int]
    examples: list[str]
    impossible: int


def run(
    name: str,
    prepare: Prepare,
    tasks: Sequence[Task],
    arms: dict[str, BenchArm],
    limit: float,
    advance: Callable[[], None] = lambda: None,
) -> Row:
    """Runs a method on goals; returns the summary.

    Args:
        name: name of the method.
        prepare: the method, see controller.bench.methods.
        tasks: the goals.
        arms: arms by name.
        limit: longest time for a goal [s].
        advance: called after each goal.
    """
    outcomes: dict[int, Outcome] = {}
    numbers = {id(task): k for k, task in enumerate(tasks)}
    tables = 0.0
    for arm_name, own in by_arm(list(tasks)).items():
        arm = arms[arm_name]
        began = time.perf_counter()
        solve, outcome = prepared(prepare, arm, own[0], limit)
        tables += time.perf_counter() - began
        for task in own:
            outcomes[numbers[id(task)]] = outcome or solved(solve, arm, task, limit)
            advance()
    return summed(name, tasks, [outcomes[k] for k in range(len(tasks))], tables)


def prepared(prepare: Prepare, arm: BenchArm, first: Task, limit: float) -> tuple[Solve, Outcome | None]:
    """Prepares a method for an arm and solves one goal; returns `solve`, or the outcome of all goals if it failed."""

    def nothing(goal: Goal, start: np.ndarray) -> None:
        """Placeholder of a method that failed."""

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
    """Returns the outcome of an exception."""
    text = " ".join(str(error).split())
    return Outcome(False, 0, seconds, kind=f"raised {type(error).__name__}", detail=text[:200])


def summed(name: str, tasks: Sequence[Task], outcomes: Sequence[Outcome], tables: float) -> Row:
    """Summarizes a method's outcomes, given in the order of the goals."""
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
