"""Plain meet in the middle with two lists: both halves up to a number of switches from the previous configuration.

After Horowitz and Sahni 1974, "Computing partitions with applications to the knapsack problem": two matched lists of
half the problem instead of one list of the whole. Rigid motions preserve distances. So the tip's error is the distance
between the goal, transformed into the frame of the middle by the lower modules, and the tip, transformed into that
frame by the upper modules. Both lists are computed for each goal.
"""

from dataclasses import dataclass

import numpy as np

from hyperbit.controller.bench.methods import paper_pop
from hyperbit.controller.bench.methods.cells import SquareCells
from hyperbit.controller.bench.methods.half_list import HalfList
from hyperbit.controller.bench.methods.matching import match
from hyperbit.controller.bench.methods.planar import Array, Planar, planar
from hyperbit.controller.manipulator.manipulator import Configuration, Manipulator
from hyperbit.controller.workspace.densities import Densities

SWITCHES = 5
NONE = 1 << 30


@dataclass(frozen=True, eq=False)
class TwoListProblem:
    """The tables of an arm."""

    arm: Planar
    lower: HalfList
    upper: HalfList
    cells: SquareCells
    switches: int
    fallback: paper_pop.PopProblem | None


def prepare(manipulator: Manipulator, densities: Densities | None, switches: int = SWITCHES) -> TwoListProblem:
    """Allocates the lists; with densities, POP answers goals that no pair of the lists reaches."""
    arm = planar(manipulator)
    middle, count = len(arm.states) // 2, len(arm.states)
    lower = HalfList(arm, arm.down, np.arange(middle), switches)
    upper = HalfList(arm, arm.up, np.arange(middle, count)[::-1], switches)
    fallback = None if densities is None else paper_pop.prepare(manipulator, densities)
    return TwoListProblem(arm, lower, upper, SquareCells(upper), switches, fallback)


def solve(problem: TwoListProblem, goal: Array, previous: Configuration, tolerance: float) -> Configuration:
    """Returns a configuration (B,) for a goal (2,)."""
    found = meet(problem, goal, previous, tolerance, NONE)
    if found is not None:
        return found[0]
    return previous if problem.fallback is None else paper_pop.solve(problem.fallback, goal, previous, tolerance)


def meet(
    problem: TwoListProblem, goal: Array, previous: Configuration, tolerance: float, below: int
) -> tuple[Configuration, int] | None:
    """Returns the configuration of fewest switches and their number; None if there is none below `below`."""
    p, costs, c = problem, problem.arm.costs(previous), problem.cells
    p.lower.list((goal[0], goal[1]), costs, p.switches)
    p.upper.list((0.0, 0.0), costs, p.switches)
    c.fill(tolerance)
    own = p.lower.points, p.lower.prices, p.lower.order, p.lower.count
    i, j, switches = match(*own, c.table, tolerance, below)
    if i < 0:
        return None
    configuration = np.empty(len(previous), dtype=np.int64)
    p.lower.write(p.lower.codes[i], configuration)
    p.upper.write(p.upper.codes[j], configuration)
    return configuration, switches
