"""Switches along lines within path tolerances: looking ahead, against the cheapest answer each time one is needed.

python -m tests.benchmarks.motion.lines. The paper's arm; what brings it to the first waypoint is not counted.
"""

import time
from itertools import pairwise

import numpy as np

from hyperbit.controller.arm.arm import load
from hyperbit.controller.motion.plans.label_setting import LabelSetting
from hyperbit.controller.motion.plans.point_by_point import PointByPoint
from hyperbit.controller.motion.plans.points import TrajectoryPoints
from hyperbit.controller.motion.plans.transitions import TransitionPlanner
from hyperbit.controller.motion.stages.pacing import Pace
from hyperbit.controller.motion.trajectory import Trajectory, along
from hyperbit.controller.search.solver import Solver
from tests.benchmarks.harness import PAPER_ARM, CommandLine, show, write_figures
from tests.benchmarks.solving import ready_solver

TOLERANCE, PATH_TOLERANCES = 0.002, (0.01, 0.02, 0.05)
PACE, LEISURE = Pace(0.06), 600.0  # [s] for each line
TURNS = np.linspace(0.0, 2.0 * np.pi, 13)
LINES = {
    "line of 0.81 m": np.array([(0.2, 2.9), (0.9, 2.5)]),
    "line of 1.24 m": np.array([(-0.6, 2.4), (0.6, 2.7)]),
    "closed curve, 12 lines": np.column_stack((0.2 + 0.4 * np.cos(TURNS), 2.5 + 0.25 * np.sin(TURNS))),
}


def greedy(solver: Solver, start: np.ndarray, trajectory: Trajectory) -> list[np.ndarray]:
    chosen = [start]
    for goal, tolerance in zip(trajectory.positions[1:], trajectory.tolerances[1:], strict=True):
        chosen.append(solver.solve(solver.target(goal, float(tolerance)), chosen[-1], timeout=10.0).configuration)
    return chosen


def ahead(solver: Solver, start: np.ndarray, trajectory: Trajectory) -> list[np.ndarray]:
    search = LabelSetting(solver, list(TrajectoryPoints(solver, trajectory))[1:], start)
    search.narrow(64)
    assert search.best.configurations is not None
    return [start, *search.best.configurations]


def figures(solver: Solver, waypoints: np.ndarray, path_tolerance: float) -> list[str]:
    times = LEISURE * np.arange(len(waypoints))
    trajectory = along(times, waypoints, TOLERANCE, path_tolerance, PACE)
    began = time.perf_counter()
    first = PointByPoint(TransitionPlanner(solver, trajectory, PACE), "minimum-switch").plan(
        np.zeros(16, dtype=np.int64)
    )
    row = [str(len(trajectory.times)), f"{1e3 * (time.perf_counter() - began):.0f}"]
    start = first.solutions[0].configuration
    for method in (lambda *_: [s.configuration for s in first.solutions], greedy, ahead):
        began = time.perf_counter()
        chosen = method(solver, start, trajectory)
        each = 1e3 * (time.perf_counter() - began) / len(chosen)
        tips = solver.manipulator.tips(chosen)[:, :2, 3]
        assert (np.linalg.norm(tips - trajectory.positions, axis=1) <= trajectory.tolerances).all()
        switches = [solver.manipulator.switches(a, b) for a, b in pairwise(chosen)]
        row.append(f"{sum(switches)} in {np.count_nonzero(switches)}")
    return [*row, f"{each:.1f}"]


def main() -> None:
    options = CommandLine(__doc__).parse()
    solver = ready_solver(load(PAPER_ARM))
    figures(solver, LINES["line of 0.81 m"], 0.1)  # loads the kernels
    rows = [
        [name, f"{path_tolerance:g}", *figures(solver, waypoints, path_tolerance)]
        for name, waypoints in LINES.items()
        for path_tolerance in PATH_TOLERANCES
    ]
    headers = ("path", "path tolerance", "points", "first plan [ms]")
    headers += ("first plan", "cheapest each time", "looking ahead", "ahead, a point [ms]")
    show(f"switches in transitions, tolerance {TOLERANCE:g} at waypoints", headers, rows)
    write_figures(options.json, rows)


if __name__ == "__main__":
    main()
