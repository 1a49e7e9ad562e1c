"""Reach and switches of the paper's arm with stuck actuators: python -m tests.benchmarks.arm.stuck [--goals N]

For every number of stuck actuators, that many are drawn some times, each stuck in a random state, and the densities of
the arm that is left are mapped. The goals are tips of random configurations of the whole arm, the same for all, each
searched from the configuration reached for the one before; and tips of configurations that lead to the edge of the
workspace.
"""

import numpy as np
from numpy.typing import NDArray

from hyperbit.controller.arm.arm import Arm, load
from hyperbit.controller.arm.weights import weights_of
from hyperbit.controller.manipulator.locked import LockedStates, lock_actuators, none_locked, transferred
from hyperbit.controller.manipulator.manipulator import Manipulator
from hyperbit.controller.search.solver import Solver
from hyperbit.controller.workspace.mapping import map_densities
from tests.benchmarks.harness import PAPER_ARM, CommandLine, show, timed, write_figures
from tests.benchmarks.search.goals import boundary
from tests.benchmarks.solving import home, random_tips

MOST, EDGE = 8, 20
HEADERS = ("stuck", "within", "worst draw", "surely out of reach", "switches", "ms", "99 % ms", "mapped in s")


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
    solver = Solver(left, densities, weights_of(arm))
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


def measured(
    arm: Arm, stuck: int, goals: NDArray[np.float64], edge: NDArray[np.float64], draws: int
) -> dict[str, float]:
    """Returns the figures of a number of stuck actuators over all draws; switches are those of goals within."""
    rng = np.random.default_rng(stuck)
    each = [searched(arm, drawn(arm.manipulator, stuck, rng), goals, edge) for _ in range(draws if stuck else 1)]
    found, mapping, on_edge = zip(*each, strict=True)
    within = [float(np.mean(rows[:, 0] <= arm.tolerance)) for rows in found]
    error, out, switches, seconds = np.concatenate(found).T
    times = (1e3 * np.median(seconds), 1e3 * np.quantile(seconds, 0.99), np.mean(mapping), np.mean(on_edge))
    figures = (stuck, np.mean(within), min(within), out.mean(), switches[error <= arm.tolerance].mean(), *times)
    return dict(zip((*HEADERS, "on the edge"), map(float, figures), strict=True))


def main() -> None:
    parser = CommandLine(__doc__, goals=250)
    parser.add_argument("--draws", type=int, default=10, help="of stuck actuators, for each number of them")
    arguments = parser.parse()
    arm = load(PAPER_ARM)
    manipulator = arm.manipulator
    densities = map_densities(manipulator, arm.pixel, arm.level_pixels)
    edge = boundary(manipulator, densities, arm.tolerance, EDGE)
    goals = random_tips(manipulator, arguments.goals)[:, : manipulator.dimension, 3]
    rows = [measured(arm, stuck, goals, edge, arguments.draws) for stuck in range(MOST + 1)]
    title = f"{arm.settings.name}, {arguments.draws} draws of stuck actuators, {len(goals)} goals each, "
    forms = ("{:.0f}", "{:.2%}", "{:.2%}", "{:.2%}", "{:.2f}", "{:.2f}", "{:.1f}", "{:.2f}", "{:.1%}")
    shown = [[form.format(it) for form, it in zip(forms, row.values(), strict=True)] for row in rows]
    show(f"{title}tolerance {arm.tolerance:g}", (*HEADERS, f"of {EDGE} on the edge"), shown)
    write_figures(arguments.json, rows)


if __name__ == "__main__":
    main()
