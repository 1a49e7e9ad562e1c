"""Large arms among obstacles, by deadline: python -m tests.benchmarks.motion.deadlines [--goals N] [--only NAME]

Each goal is the tip of a random configuration that is clear of random obstacles, drawn anew for every few goals. The
arm starts from another clear configuration. All deadlines plan each goal one after the other, in an order that turns
with each goal, so that they share the load of the machine and the caches of swept checks. A configuration exists for
each goal; whether a clear transition to it exists is not known.
"""

from collections import Counter

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
from tests.benchmarks.harness import DEPLOY, CommandLine, joined, show, timed, write_figures
from tests.benchmarks.motion.obstacle_transitions import scene
from tests.benchmarks.search.obstacles import drawn
from tests.benchmarks.solving import ready_solver
from tests.obstacles.dense import obstacles_of

DEADLINES = (0.05, 0.5, 5.0)  # [s]
THREADS = 2
EACH, RADIUS = 5, 0.02  # goals among the same obstacles; half the thickness of the bodies
FEWEST = 0.02  # least share of clear configurations


def planned(arm: Arm, solver: Solver, goal: np.ndarray, start: np.ndarray, deadline: float) -> str:
    """Plans a goal; returns the reason of its refusal, or "found"."""
    planner = TransitionPlanner(solver, through(np.zeros(1), goal[None], arm.tolerance), pace_of(arm.settings))
    allowed = search_time(min(PLANNING_TIME, deadline), PlanningSettings().seconds_per_switch, deadline)
    try:
        PointByPoint(planner, "minimum-switch", allowed, THREADS).plan(start)
    except Refusal as refusal:
        return str(refusal.reason.value)
    return "found"


def measured(name: str, count: int) -> tuple[dict[float, Counter[str]], dict[float, list[float]]]:
    """Returns the outcomes of each deadline, "found" or the reason, and the times [s]."""
    arm, rng = load(DEPLOY / name), np.random.default_rng(4)
    m, solver, done = arm.manipulator, ready_solver(arm), 0
    outcomes, times = {it: Counter[str]() for it in DEADLINES}, {it: list[float]() for it in DEADLINES}
    while done < count:
        clearance = BodyClearance(m, obstacles_of(scene(m, rng)), RADIUS)
        some = rng.integers(0, m.states, (500, len(m.states)))
        if np.mean(~clearance.blocked(some)) < FEWEST:
            continue
        chosen, _ = drawn(clearance, 2 * EACH, rng)
        own = solver.avoiding(clearance)
        for start, end in zip(chosen[:EACH], chosen[EACH:], strict=True):
            goal = m.tip(end)[: m.dimension, 3]
            for k in range(len(DEADLINES)):
                deadline = DEADLINES[(done + k) % len(DEADLINES)]
                outcome, seconds = timed(lambda d=deadline, g=goal, s=start, own=own: planned(arm, own, g, s, d))
                outcomes[deadline][outcome] += 1
                times[deadline].append(seconds)
            done += 1
    return outcomes, times


def main() -> None:
    given, figures = CommandLine(__doc__, goals=100, only="platform8,revolute24").parse(), {}
    for name in given.only.split(","):
        outcomes, times = measured(f"{name}.yaml", given.goals)
        reasons = ["found", *sorted({reason for own in outcomes.values() for reason in own} - {"found"})]
        rows = [
            (f"{deadline:g}", *(f"{own[reason] / own.total():.1%}" for reason in reasons), joined(times[deadline]))
            for deadline, own in outcomes.items()
        ]
        show(f"{name}: {given.goals} goals", ("deadline [s]", *reasons, "median / 99 % / 99.9 % / worst [ms]"), rows)
        figures[name] = {"outcomes": outcomes, "times": times}
    write_figures(given.json, figures)


if __name__ == "__main__":
    main()
