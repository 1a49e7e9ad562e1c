"""Results of each method for poses of random configurations: python -m tests.benchmarks.search.poses

Each goal is asked for from the configuration reached for the one before. Fewest switches are held to what the same
search proves when it is given more time, from the same configurations. With --busy deadlines and times are those of the
thread on its processor, so that other programs do not count.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hyperbit.controller.arm.arm import load
from hyperbit.controller.manipulator.manipulator import Configuration
from hyperbit.controller.search.solution import Solution
from hyperbit.controller.search.solver import Solver
from tests.benchmarks.harness import DEPLOY, CommandLine, show, write_figures
from tests.benchmarks.solving import Solve, home, random_tips, ready_solver, solved_in_sequence

PROVING = 2.0  # [s] for a proof

Figures = tuple[float, float, str, float]  # switches, error, certificate and time [s]


@dataclass(frozen=True)
class Experiment:
    """An arm's file, how many goals, and the tolerances of position (in lengths of the arm, or its unit) and angle."""

    file: str
    goals: int
    tolerance: float
    turn: float
    relative: bool = False


EXPERIMENTS = (
    Experiment("planar16.yaml", 500, 0.005, 0.03),
    Experiment("platform8.yaml", 200, 0.01, math.radians(3.0), relative=True),
)


def measured(experiment: Experiment, number: int) -> dict[str, list[Figures]]:
    arm = load(DEPLOY / experiment.file)
    m = arm.manipulator
    tolerance, turn = experiment.tolerance * (m.length if experiment.relative else 1.0), experiment.turn
    solver, count = ready_solver(arm), min(number, experiment.goals)
    goals = random_tips(m, count)
    ways: dict[str, Solve] = {
        "minimum-switch": lambda goal, previous: solver.solve(solver.target(goal, tolerance, turn), previous),
        "minimum-switch, position only": lambda goal, previous: solver.solve(solver.target(goal, tolerance), previous),
        "ipop-fewest-switches": lambda goal, previous: solver.solve(
            solver.target(goal, tolerance, turn), previous, "ipop-fewest-switches"
        ),
        "pop": lambda goal, previous: solver.solve(solver.target(goal, tolerance, turn), previous, "pop"),
    }
    title = f"{experiment.file}: {count} poses, tolerance {tolerance:.3g} and {turn:.3g} rad"
    proofs, figures, rows = "", {}, []
    for name, solve in ways.items():
        before, found = solved_in_sequence(solve, goals, home(m))
        if name == "minimum-switch":
            proofs = proven(solver, tolerance, turn, goals, before, found)
        switches, times = [f.switches for f in found], 1e3 * np.array([f.seconds for f in found])
        spent = " / ".join(f"{t:.2f}" for t in (np.median(times), np.quantile(times, 0.99), times.max()))
        within, optimal = (
            np.mean([getattr(f, name) is True for f in found]) for name in ("within_tolerance", "optimal")
        )
        numbers = f"{np.mean(switches):.2f} / {max(switches)}"
        rows.append((name, f"{within:.1%}", f"{optimal:.0%}", numbers, spent))
        figures[name] = [(f.switches, f.error, f.certificate, f.seconds) for f in found]
    headers = ("method", "within", "proven", "switches, mean / most", "median / 99 % / most [ms]")
    show(f"{title}; {proofs}", headers, rows)
    return figures


def proven(
    solver: Solver,
    tolerance: float,
    turn: float,
    goals: NDArray[np.float64],
    before: list[Configuration],
    found: list[Solution],
) -> str:
    own = least = known = 0
    for goal, previous, solution in zip(goals, before, found, strict=True):
        proof = solver.solve(solver.target(goal, tolerance, turn), previous, timeout=PROVING)
        if proof.optimal and solution.within_tolerance:
            own, least, known = own + solution.switches, least + proof.switches, known + 1
    ratio = f"{own / least:.3f}" if least else "-"
    return f"minimum-switch: {ratio} times the fewest, over the {known} of {len(goals)} proven in {PROVING:g} s each"


def main() -> None:
    given = CommandLine(__doc__, goals=500, busy=True).parse()
    figures = {one.file: measured(one, given.goals) for one in EXPERIMENTS}
    write_figures(given.json, figures)


if __name__ == "__main__":
    main()
