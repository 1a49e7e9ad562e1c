"""Improves the trajectories of the benchmark: their best known plans and proven bounds.

python -m tests.benchmarks.proofs.trajectories --seconds 60

The trajectories are the random curves of tests/benchmarks/motion/trajectories.py. A plan or bound of the file stays
until a better one is found. Without --write nothing is written.
"""

import argparse
import csv
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hyperbit.controller.armfile.csv_files import read_csv
from hyperbit.controller.bench.goal_sets import FOLDER, load_arm
from hyperbit.controller.manipulator.manipulator import Configuration
from hyperbit.controller.manipulator.notation import format_configuration, parse_configuration
from hyperbit.controller.motion.plans.label_setting import LabelSetting
from hyperbit.controller.motion.plans.points import TrajectoryPoints
from hyperbit.controller.motion.plans.whole import proof_means
from hyperbit.controller.motion.trajectory import through
from hyperbit.controller.search.solver import Solver
from tests.benchmarks.motion.trajectories import SPACINGS, curve, greedy
from tests.benchmarks.solving import ready_solver

FILE = FOLDER / "trajectories.csv"
ARM, CURVES, SEED, TOLERANCE = "planar16", 3, 7, 0.002


class Curve(NamedTuple):
    spacing: float  # between waypoints
    start: Configuration  # shape (B,)
    waypoints: NDArray[np.float64]  # in the world, shape (n, 2)
    tolerance: float
    bound: int  # proven lower bound of the switches
    best: NDArray[np.int64]  # best known plan, shape (n, B)

    @property
    def switches(self) -> int:
        m = load_arm(ARM).manipulator
        return sum(m.switches(a, b) for a, b in zip([self.start, *self.best], self.best, strict=False))


def read() -> list[Curve]:
    m, (columns, rows) = load_arm(ARM).manipulator, read_csv(FILE)
    result = list[Curve]()
    for row in (dict(zip(columns, row.fields, strict=True)) for row in rows):
        points = np.array([point.split() for point in row["waypoints"].split(";")], dtype=float)
        best = np.array([parse_configuration(m, text) for text in row["best"].split()])
        start, numbers = parse_configuration(m, row["start"]), (float(row["tolerance"]), int(row["bound"]))
        result.append(Curve(float(row["spacing"]), start, points, *numbers, best))
    return result


def drawn(solver: Solver) -> list[Curve]:
    """Returns the curves with the plan that takes the cheapest configuration each time."""
    result = list[Curve]()
    for spacing in SPACINGS:
        rng = np.random.default_rng(SEED)
        for _ in range(CURVES):
            start, trajectory = curve(solver.manipulator, spacing, rng)
            best = greedy(solver, start, trajectory)[1:]
            result.append(Curve(spacing, start, trajectory.positions, TOLERANCE, 0, best))
    return result


def improved(solver: Solver, known: Curve, seconds: float) -> Curve:
    trajectory = through(np.arange(float(len(known.waypoints))), known.waypoints, known.tolerance)
    points = list(TrajectoryPoints(solver, trajectory))
    search = LabelSetting(solver, points, known.start, lambda: False, *proof_means())
    search.offer(known.best, known.switches)
    found = search.run(seconds)
    assert found.configurations is not None
    return known._replace(best=found.configurations, bound=max(known.bound, round(found.bound)))


def write(curves: list[Curve]) -> None:
    m = load_arm(ARM).manipulator
    with FILE.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(("arm", "spacing", "start", "waypoints", "tolerance", "bound", "best"))
        for each in curves:
            points = ";".join(f"{x!r} {y!r}" for x, y in each.waypoints.tolist())
            best = " ".join(format_configuration(m, row) for row in each.best)
            start = format_configuration(m, each.start)
            writer.writerow((ARM, each.spacing, start, points, each.tolerance, each.bound, best))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=60.0, help="for each curve")
    parser.add_argument("--write", action="store_true")
    given = parser.parse_args()
    solver = ready_solver(load_arm(ARM))
    curves = read() if FILE.exists() else drawn(solver)
    for k, known in enumerate(curves):
        curves[k] = better = improved(solver, known, given.seconds)
        was, now = (f"{each.switches} switches, bound {each.bound}" for each in (known, better))
        print(f"{better.spacing:g}: {was} -> {now}", flush=True)
        if given.write:
            write(curves)
    for spacing in SPACINGS:
        own = [each for each in curves if each.spacing == spacing]
        switches, bound = (np.mean([getattr(each, name) for each in own]) for name in ("switches", "bound"))
        gap = np.mean([each.switches / each.bound - 1 for each in own])
        print(f"spacing {spacing:g}: {switches:.1f} switches, bound {bound:.1f}, mean gap {gap:.0%}")


if __name__ == "__main__":
    main()
