"""Whole trajectories of the paper's arm: switches and proven bounds: python -m tests.benchmarks.motion.trajectories

Random curves with 30 waypoints, each from the arm's present configuration. In the same run: the search over the whole
trajectory, the cheapest configuration for each waypoint (greedy), the daemon's first plan, and what is left of it to
switch after its improvement while the arm moves.
"""

import time

import numpy as np
from numpy.typing import NDArray

from hyperbit.controller.arm.arm import load
from hyperbit.controller.manipulator.manipulator import Configuration, Manipulator
from hyperbit.controller.motion.plans.improvement import Improvement
from hyperbit.controller.motion.plans.label_setting import LabelSetting
from hyperbit.controller.motion.plans.point_by_point import PointByPoint
from hyperbit.controller.motion.plans.points import TrajectoryPoints
from hyperbit.controller.motion.plans.transitions import TransitionPlanner
from hyperbit.controller.motion.plans.whole import proof_means
from hyperbit.controller.motion.stages.pacing import Pace
from hyperbit.controller.motion.trajectory import Trajectory, through
from hyperbit.controller.search.method import MINIMUM_SWITCH
from hyperbit.controller.search.solver import Solver
from tests.benchmarks.harness import PAPER_ARM, CommandLine, show, write_figures
from tests.benchmarks.solving import ready_solver

WAYPOINTS = 30
SPACINGS = (0.0005, 0.001, 0.02, 0.1)  # between waypoints
INTERVAL = 0.5  # [s] between waypoints of a goal in the daemon
PACE = Pace(0.06)


def curve(manipulator: Manipulator, spacing: float, rng: np.random.Generator) -> tuple[Configuration, Trajectory]:
    while True:
        start = rng.integers(0, manipulator.states)
        heading = rng.uniform(0, 2 * np.pi)
        bend, wave = rng.uniform(-1, 1, 2) * min(spacing / 0.2, 0.5)
        headings = heading + np.cumsum(bend + wave * np.sin(np.arange(WAYPOINTS) / 5))
        steps = spacing * np.column_stack((np.cos(headings), np.sin(headings)))
        points = manipulator.tip(start)[:2, 3] + np.cumsum(steps, axis=0)
        if np.abs(points[:, 0]).max() < 1.0 and points[:, 1].min() > 1.8 and np.linalg.norm(points, axis=1).max() < 2.9:
            return start, through(INTERVAL * np.arange(1, WAYPOINTS + 1), points, 0.002)


def greedy(solver: Solver, start: Configuration, trajectory: Trajectory) -> NDArray[np.int64]:
    rows = [start]
    for k, tolerance in enumerate(trajectory.tolerances.tolist()):
        rows.append(solver.solve(solver.target(trajectory.goal(k), tolerance), rows[-1]).configuration)
    return np.array(rows)


def measured(solver: Solver, start: Configuration, trajectory: Trajectory, seconds: float) -> dict[str, float]:
    """Returns costs: greedy, of the daemon's first plan, after its improvement, of the search; and the bound."""
    planner = TransitionPlanner(solver, trajectory, PACE)
    first = PointByPoint(planner, MINIMUM_SWITCH).plan(start)
    moving = [first, *Improvement(planner, first, time.monotonic()).plans()][-1]
    rows = greedy(solver, start, trajectory)
    cheapest = float(solver.cost(rows[1:], rows[:-1]).sum())
    search = LabelSetting(solver, list(TrajectoryPoints(solver, trajectory)), start, lambda: False, *proof_means())
    search.offer(rows[1:], cheapest)  # as the product does
    found = search.run(seconds)
    costs = {"greedy": cheapest, "first": first.cost, "moving": moving.cost, "plan": found.cost, "bound": found.bound}
    return costs | {"gap": found.cost / found.bound - 1}


def main() -> None:
    given = CommandLine(__doc__, curves=20, seconds=4.0).parse()
    solver, rows = ready_solver(load(PAPER_ARM)), []
    for spacing in SPACINGS:
        rng = np.random.default_rng(7)
        own = [measured(solver, *curve(solver.manipulator, spacing, rng), given.seconds) for _ in range(given.curves)]
        rows.append({"spacing": spacing} | {key: float(np.mean([row[key] for row in own])) for key in own[0]})
    shown = [[f"{number:.4g}" for number in row.values()] for row in rows]
    show(f"{given.curves} curves of {WAYPOINTS} waypoints, means", list(rows[0]), shown)
    write_figures(given.json, rows)


if __name__ == "__main__":
    main()
