"""Reach and switches of the paper's arm with stuck actuators: python -m tests.benchmarks.arm.stuck [--goals N]

For every number of stuck actuators, that many are drawn some times, each stuck in a random state, and the densities of
the arm that is left are mapped. The goals are tips of random configurations of the whole arm, the same for all, each
searched from the configuration reached for the one before; and tips of configurations that lead to the edge of the
workspace.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table

from hyperbit.controller.arm.arm import Arm, load
from hyperbit.controller.manipulator.locked import LockedStates, lock_actuators, none_locked, transferred
from hyperbit.controller.manipulator.manipulator import Manipulator
from hyperbit.controller.search.solver import Solver
from hyperbit.controller.workspace.mapping import map_densities
from tests.benchmarks.harness import PAPER_ARM, CommandLine, timed, write_figures
from tests.benchmarks.search.goals import boundary
from tests.benchmarks.solving import home, random_tips

MOST, EDGE = 8, 20


@dataclass(frozen=True)
class Row:
    """So many stuck: shares of the goals within the tolerance, mean switches, and times [s], over all draws.

    Switches are those for goals within the tolerance.
    """

    stuck: int
    within: float
    worst: float
    excluded: float
    switches: float
    seconds: float
    seconds_99: float
    mapping: float
    edge: float


def drawn(manipulator: Manipulator, stuck: int, rng: np.random.Generator) -> LockedStates:
    held = none_locked(manipulator)
    chosen = rng.choice(len(held), stuck, replace=False)
    held[chosen] = manipulator.actuator_states(rng.integers(0, manipulator.states))[chosen]
    return held


def searched(
    arm: Arm, held: LockedStates, goals: NDArray[np.float64], edge: NDArray[np.float64]
) -> tuple[NDArray[np.float64], float, float]:
    """Returns error, whether surely out of reach, switches and seconds of each goal (n, 4).

    And the time of mapping, and the share of the goals on the edge within the tolerance.
    """
    left = lock_actuators(arm.manipulator, held)
    densities, mapping = timed(lambda: map_densities(left, arm.pixel, arm.level_pixels))
    solver = Solver(left, densities, arm.weights())
    solver.prepare()
    reached, rows = home(left), []
    for goal in goals:
        found = solver.solve(solver.target(goal, arm.tolerance), reached)
        reached = found.configuration
        states = arm.manipulator.actuator_states(transferred(reached, left, arm.manipulator))
        if not np.array_equal(states[held >= 0], held[held >= 0]):
            raise AssertionError("a held actuator was to switch")
        rows.append((found.error, found.certificate == "unreachable", found.switches, found.seconds))
    there = [solver.solve(solver.target(goal, arm.tolerance), reached).within_tolerance for goal in edge]
    return np.array(rows, dtype=float), mapping, float(np.mean(there))


def measured(arm: Arm, stuck: int, goals: NDArray[np.float64], edge: NDArray[np.float64], draws: int) -> Row:
    rng = np.random.default_rng(stuck)
    each = [searched(arm, drawn(arm.manipulator, stuck, rng), goals, edge) for _ in range(draws if stuck else 1)]
    found, mapping, on_edge = zip(*each, strict=True)
    within = [float(np.mean(rows[:, 0] <= arm.tolerance)) for rows in found]
    error, out, switches, seconds = np.concatenate(found).T
    return Row(
        stuck,
        float(np.mean(within)),
        min(within),
        float(out.mean()),
        float(switches[error <= arm.tolerance].mean()),
        float(np.median(seconds)),
        float(np.quantile(seconds, 0.99)),
        float(np.mean(mapping)),
        float(np.mean(on_edge)),
    )


def main() -> None:
    parser = CommandLine(__doc__, goals=250)
    parser.add_argument("--draws", type=int, default=10, help="of stuck actuators, for each number of them")
    arguments = parser.parse()
    arm = load(PAPER_ARM)
    manipulator = arm.manipulator
    densities = map_densities(manipulator, arm.pixel, arm.level_pixels)
    edge = boundary(manipulator, densities, arm.tolerance, EDGE)
    goals = random_tips(manipulator, arguments.goals)[:, : manipulator.dimension, 3]
    head = f"{arm.settings.name}, {arguments.draws} draws of stuck actuators, {len(goals)} goals each,"
    table = Table("stuck", title=f"{head} tolerance {arm.tolerance:g}")
    for header in (
        "within",
        "worst draw",
        "surely out of reach",
        "switches",
        "ms",
        "99 % ms",
        "mapped in s",
        f"of {EDGE} on the edge",
    ):
        table.add_column(header, justify="right")
    rows = []
    for stuck in range(MOST + 1):
        r = measured(arm, stuck, goals, edge, arguments.draws)
        shares = (f"{share:.2%}" for share in (r.within, r.worst, r.excluded))
        times = (f"{1e3 * r.seconds:.2f}", f"{1e3 * r.seconds_99:.1f}", f"{r.mapping:.2f}")
        table.add_row(str(stuck), *shares, f"{r.switches:.2f}", *times, f"{r.edge:.1%}")
        rows.append(r)
    Console(width=max(110, Console().width)).print(table)
    write_figures(arguments.json, rows)


if __name__ == "__main__":
    main()
