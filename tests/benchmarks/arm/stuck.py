"""Reach and switches of the paper's arm with stuck actuators: python -m tests.benchmarks.arm.stuck [--goals N]

For every number of stuck actuators, that many are drawn some times, each stuck in a random state, and the densities of
the arm that is left are mapped. The goals are tips of random configurations of the whole arm, the same for all, and
tips at the edge of the workspace.
"""

import numpy as np

from hyperbit.controller.arm.arm import Arm, load
from hyperbit.controller.arm.weights import weights_of
from hyperbit.controller.manipulator.locked import LockedStates, lock_actuators, none_locked, transferred
from hyperbit.controller.manipulator.manipulator import Manipulator
from hyperbit.controller.search.solver import Solver
from hyperbit.controller.workspace.mapping import map_densities
from tests.benchmarks.harness import PAPER_ARM, CommandLine, show, write_figures
from tests.benchmarks.solving import Goals, by, home, random_tips, sparse_tips, traced

MOST, EDGE = 8, 20
HEADERS = ("stuck", "within [%]", "worst draw [%]", "switches", f"of {EDGE} on the edge [%]", "ms")


def drawn(manipulator: Manipulator, stuck: int, rng: np.random.Generator) -> LockedStates:
    held = none_locked(manipulator)
    chosen = rng.choice(len(held), stuck, replace=False)
    held[chosen] = manipulator.actuator_states(rng.integers(0, manipulator.states))[chosen]
    return held


def searched(arm: Arm, held: LockedStates, goals: Goals, edge: Goals) -> tuple[float, float, float, float]:
    """Returns the share of goals that are reached, their mean switches, the share at the edge, and the time [ms]."""
    left = lock_actuators(arm.manipulator, held)
    solver = Solver(left, map_densities(left, arm.pixel, arm.level_pixels), weights_of(arm))
    solver.prepare()
    solve = by(solver, "minimum-switch", arm.tolerance)
    trace = traced(solve, goals, home(left))
    for solution in trace.found:
        states = arm.manipulator.actuator_states(transferred(solution.configuration, left, arm.manipulator))
        if not np.array_equal(states[held >= 0], held[held >= 0]):
            raise AssertionError("a held actuator was to switch")
    reached = trace.found[-1].configuration
    at_edge = float(np.mean([solve(goal, reached).within_tolerance for goal in edge]))
    switches = float(np.mean([solution.switches for solution in trace.reached]))
    return len(trace.reached) / len(goals), switches, at_edge, 1e3 * float(np.median(trace.seconds))


def main() -> None:
    given, arm = CommandLine(__doc__, goals=250, draws=10).parse(), load(PAPER_ARM)
    m = arm.manipulator
    edge = sparse_tips(m, map_densities(m, arm.pixel, arm.level_pixels), arm.tolerance, EDGE)
    goals, rows = random_tips(m, given.goals), []
    for stuck in range(MOST + 1):
        rng = np.random.default_rng(stuck)
        each = [searched(arm, drawn(m, stuck, rng), goals, edge) for _ in range(given.draws if stuck else 1)]
        within, switches, at_edge, ms = (list(column) for column in zip(*each, strict=True))
        shares = (100 * np.mean(within), 100 * min(within), np.mean(switches), 100 * np.mean(at_edge), np.mean(ms))
        rows.append((stuck, *(round(float(number), 2) for number in shares)))
    show(f"{given.draws} draws, {given.goals} goals each, tolerance {arm.tolerance:g}", HEADERS, rows)
    write_figures(given.json, [dict(zip(HEADERS, row, strict=True)) for row in rows])


if __name__ == "__main__":
    main()
