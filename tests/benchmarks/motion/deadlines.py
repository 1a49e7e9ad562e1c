"""Large arms among obstacles, by deadline: python -m tests.benchmarks.motion.deadlines [--goals N] [--only NAME]

Each goal is the tip of a random configuration that is clear of random obstacles, drawn anew for every few goals. The
arm starts from another clear configuration. All deadlines plan each goal one after the other, in an order that turns
with each goal, so that they share the load of the machine and the caches of swept checks. A configuration exists for
each goal; whether a clear transition to it exists is not known.
"""

import time
from collections import Counter
from dataclasses import dataclass, field

import numpy as np

from hyperbit.controller.arm.arm import Arm, load
from hyperbit.controller.armfile.settings import PlanningSettings
from hyperbit.controller.motion.plans.point_by_point import PLANNING_TIME, PointByPoint
from hyperbit.controller.motion.plans.transitions import TransitionPlanner
from hyperbit.controller.motion.stages.pacing import pace_of
from hyperbit.controller.motion.trajectory import through
from hyperbit.controller.obstacles.clearance import BodyClearance
from hyperbit.controller.refusals.refusal import Refusal
from hyperbit.controller.search.search_time import search_time
from hyperbit.controller.search.solver import Solver
from tests.benchmarks.harness import DEPLOY, CommandLine, percentiles, show, write_figures
from tests.benchmarks.motion.obstacle_transitions import scene
from tests.benchmarks.search.obstacles import drawn
from tests.benchmarks.solving import ready_solver
from tests.obstacles.dense import obstacles_of

DEADLINES = (0.05, 0.5, 5.0)  # [s]
THREADS = 2
EACH, RADIUS = 5, 0.02  # goals among the same obstacles; half the thickness of the bodies
FEWEST = 0.02  # least share of clear configurations


@dataclass
class Tally:
    """Outcomes of one deadline: reasons, "found" for a plan; and times [s]."""

    outcomes: Counter[str] = field(default_factory=Counter)
    seconds: list[float] = field(default_factory=list)


def planned(arm: Arm, solver: Solver, goal: np.ndarray, start: np.ndarray, deadline: float) -> str:
    """Plans a goal; returns the reason of its refusal, or "found"."""
    planner = TransitionPlanner(solver, through(np.zeros(1), goal[None], arm.tolerance), pace_of(arm.settings))
    allowed = search_time(min(PLANNING_TIME, deadline), PlanningSettings().seconds_per_switch, deadline)
    try:
        PointByPoint(planner, "minimum-switch", allowed, THREADS).plan(start)
    except Refusal as refusal:
        return str(refusal.reason.value)
    return "found"


def measured(name: str, count: int) -> dict[float, Tally]:
    arm, rng = load(DEPLOY / name), np.random.default_rng(4)
    m, solver, tallies = arm.manipulator, ready_solver(arm), {deadline: Tally() for deadline in DEADLINES}
    done = 0
    while done < count:
        clearance = BodyClearance(m, obstacles_of(scene(m, rng)), RADIUS)
        some = rng.integers(0, m.states, (500, len(m.states)))
        if np.mean(~clearance.blocked(some)) < FEWEST:
            continue
        chosen, _ = drawn(clearance, 2 * EACH, rng)
        own = solver.avoiding(clearance)
        for start, end in zip(chosen[:EACH], chosen[EACH:], strict=True):
            for k in range(len(DEADLINES)):
                deadline = DEADLINES[(done + k) % len(DEADLINES)]
                began, tally = time.perf_counter(), tallies[deadline]
                tally.outcomes[planned(arm, own, m.tip(end)[: m.dimension, 3], start, deadline)] += 1
                tally.seconds.append(time.perf_counter() - began)
            done += 1
    return tallies


def main() -> None:
    parser = CommandLine(__doc__, goals=100)
    parser.add_argument("--only", default="platform8,revolute24", help="names of the arms' files")
    given = parser.parse()
    figures = {}
    for name in given.only.split(","):
        tallies = measured(f"{name}.yaml", given.goals)
        reasons = sorted({reason for tally in tallies.values() for reason in tally.outcomes} - {"found"})
        rows = []
        for deadline, tally in tallies.items():
            times, total = percentiles(tally.seconds, "p50", "p99", "worst"), tally.outcomes.total()
            shares = (f"{tally.outcomes[reason] / total:.1%}" for reason in ("found", *reasons))
            rows.append((f"{deadline:g}", *shares, " / ".join(f"{t:.3g}" for t in times.values())))
            figures[f"{name} {deadline:g}"] = dict(tally.outcomes) | times
        show(f"{name}: {given.goals} goals", ("deadline [s]", "found", *reasons, "p50 / p99 / worst [ms]"), rows)
    write_figures(given.json, figures)


if __name__ == "__main__":
    main()
