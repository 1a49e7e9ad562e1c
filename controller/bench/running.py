"""Runs methods on goal sets and summarizes the outcomes."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hyperbit.controller.bench.checking import Outcome
from hyperbit.controller.bench.goal_sets import Task, by_arm, load_arm
from hyperbit.controller.bench.method_job import MethodJob
from hyperbit.controller.bench.methods import Prepare
from hyperbit.controller.studies.shares import Spread, alone

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
