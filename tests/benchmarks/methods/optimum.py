"""The fewest switches there are, proven: every way in which the halves can share them is gone through.

Both halves are listed to `h` switches and met. A pair left out has more than h in one half, or in both. With more in
one, the other is in its table: all rows of the one, up to the switches still allowed, are gone through one by one and
asked of that table. With more in both, there are at least 2 h + 2. So what was found is optimal if it has no more than
that, and h grows until it is so.
"""

import time
from dataclasses import dataclass, field

import numpy as np

from controller.manipulator.manipulator import Configuration, Manipulator
from controller.workspace.densities import Densities
from tests.benchmarks.methods import meeting
from tests.benchmarks.methods.cells import Cells
from tests.benchmarks.methods.halves import Half
from tests.benchmarks.methods.matching import go_through
from tests.benchmarks.methods.meeting import NONE
from tests.benchmarks.methods.planar import Array, Index

SECONDS = 2.0
FIRST, DEEPEST = 4, 5  # so that twelve switches can be proven to be the fewest


@dataclass(frozen=True, eq=False)
class Tables:
    halves: meeting.Problem
    lower_cells: Cells


@dataclass(frozen=True, eq=False)
class Problem:
    """Tables by the switches they go to, allocated once needed."""

    manipulator: Manipulator
    depths: dict[int, Tables] = field(default_factory=dict)

    def table(self, depth: int) -> Tables:
        if depth not in self.depths:
            halves = meeting.prepare(self.manipulator, None, depth)
            self.depths[depth] = Tables(halves, Cells(halves.lower))
        return self.depths[depth]


def prepare(manipulator: Manipulator, densities: Densities) -> Problem:
    return Problem(manipulator)


def solve(problem: Problem, goal: Array, previous: Configuration, tolerance: float) -> Configuration | None:
    """Returns a configuration of provably fewest switches, or None where the time did not suffice."""
    began, best, fewest = time.perf_counter(), None, NONE
    for depth in range(FIRST, DEEPEST + 1):
        table = problem.table(depth)
        halves, costs = table.halves, table.halves.arm.costs(previous)
        found = meeting.meet(halves, goal, previous, tolerance, fewest)
        best, fewest = found or (best, fewest)
        if fewest <= depth + 1:
            return best
        # Both halves are listed now, the upper one sorted into cells too.
        table.lower_cells.fill(tolerance)
        upwards = halves.lower, (goal[0], goal[1]), halves.upper, halves.cells
        downwards = halves.upper, (0.0, 0.0), halves.lower, table.lower_cells
        for asking, start, answering, cells in (upwards, downwards):
            most = min(fewest - 1, 2 * depth + 1)
            code, row, fewest = ask(asking, start, costs, most, depth, cells, tolerance, fewest)
            if row >= 0:
                best = np.empty(len(previous), dtype=np.int64)
                asking.write(code, best)
                answering.write(answering.codes[row], best)
        if fewest <= 2 * depth + 2:
            return best
        if time.perf_counter() - began > SECONDS / 4:  # the next depth takes three times as long
            break
    return None


def ask(
    asking: Half,
    start: tuple[float, float],
    costs: Index,
    most: int,
    listed: int,
    cells: Cells,
    tolerance: float,
    best: int,
) -> tuple[int, int, int]:
    """Returns the best pair of a row of more than `listed` switches, up to `most`, and one of the other's table."""
    own = np.ascontiguousarray(costs[asking.modules])
    return go_through(*start, asking.motions, own, asking.states, most, listed, cells.table, tolerance, best)
