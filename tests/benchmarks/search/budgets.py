"""Compares minimum-switch and annealing at equal times, and the times in which they solve a share of the goals.

Annealing gets increasing times, until it solves as large a share with as few switches as minimum-switch by its own
deadline, or until LONGEST for each goal.
"""

from dataclasses import dataclass

import numpy as np
from rich.table import Table

from hyperbit.controller.search.solver import TIMEOUT
from tests.benchmarks.search.measuring import Arm, Goals, Trace, prepared, traced
from tests.benchmarks.search.methods import METHODS, OURS, Method, annealed, ours

BUDGETS = (0.001, 0.003, 0.01, 0.03, 0.1, 0.3, 1.0)  # [s] for a goal
LONGEST = BUDGETS[-1]
MOST_TIME = 250.0  # [s] for all goals of one rung, which limits the time of a comparison
SHARES = (0.5, 0.9, 0.99, 1.0)
FIRST = "annealing, first found"


@dataclass(frozen=True)
class Rung:
    """Results of one method with a time for each goal: share within the tolerance, switches, and times [s]."""

    method: str
    budget: float
    within: float
    switches_mean: float
    switches_worst: int
    seconds_mean: float
    seconds_median: float


@dataclass(frozen=True)
class Reached:
    """Times [s] after which a method has solved SHARES of the goals; None: never."""

    method: str
    seconds: tuple[float | None, ...]
    switches_mean: float


def ladder(arm: Arm, goals: Goals) -> list[Rung]:
    """Measures ours and annealing at growing budgets."""
    own = rung(ours(OURS, TIMEOUT), TIMEOUT, arm, goals)
    rungs = [own]
    for budget in BUDGETS:
        if budget * len(goals) > MOST_TIME:
            break
        if budget < TIMEOUT:
            rungs.append(rung(ours(OURS, budget), budget, arm, goals))
        rungs.append(rung(annealed("annealing", budget), budget, arm, goals))
        if rungs[-1].within >= own.within and rungs[-1].switches_mean <= own.switches_mean:
            break
    return rungs


def rung(method: Method, budget: float, arm: Arm, goals: Goals) -> Rung:
    """Measures one method."""
    trace = traced(method, prepared(method, arm)[0], arm, goals)
    within, switches, seconds = share(trace, arm), trace.switches, trace.seconds
    times = float(seconds.mean()), float(np.median(seconds))
    return Rung(method.name, budget, within, float(switches.mean()), int(switches.max()), *times)


def share(trace: Trace, arm: Arm) -> float:
    """Returns the share of goals within the tolerance."""
    return float(np.mean(trace.errors <= arm.tolerance))


def reached(arm: Arm, goals: Goals) -> list[Reached]:
    """Measures the time to the first solution of hyperbit's methods and of annealing."""
    result = []
    for method in (*METHODS[:2], annealed(FIRST, LONGEST, first=True)):
        trace = traced(method, prepared(method, arm)[0], arm, goals)
        times = np.sort(np.where(trace.errors <= arm.tolerance, trace.seconds, np.inf))
        by = [float(times[int(np.ceil(q * len(times))) - 1]) for q in SHARES]
        result.append(
            Reached(method.name, tuple(t if np.isfinite(t) else None for t in by), float(trace.switches.mean()))
        )
    return result


def ladder_table(rungs: list[Rung], number: int) -> Table:
    """Returns the table of the budgets."""
    table = Table("method", title=f"equal times: {number} goals, annealing in restarted runs, the best of all kept")
    for header in ("budget\nms", "within", "switches", "worst", "mean\nms", "median\nms"):
        table.add_column(header, justify="right")
    for r in rungs:
        times = (f"{1e3 * t:.3g}" for t in (r.seconds_mean, r.seconds_median))
        figures = f"{1e3 * r.budget:g}", f"{r.within:.1%}", f"{r.switches_mean:.2f}", f"{r.switches_worst}"
        table.add_row(r.method, *figures, *times)
    return table


def reached_table(rows: list[Reached], number: int) -> Table:
    """Returns the table of the times to a share."""
    table = Table("method", title=f"time by which a share of {number} goals is answered within the tolerance")
    for q in SHARES:
        table.add_column(f"{q:.0%}\nms", justify="right")
    table.add_column("switches", justify="right")
    for r in rows:
        times = ("never" if t is None else f"{1e3 * t:.3g}" for t in r.seconds)
        table.add_row(r.method, *times, f"{r.switches_mean:.2f}")
    return table
