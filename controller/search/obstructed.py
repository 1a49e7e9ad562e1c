"""How much of its workspace an arm loses to obstacles, and to which: a sample of positions, each searched."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hyperbit.controller.search.clock import EFFORT
from hyperbit.controller.search.search_time import SearchTime
from hyperbit.controller.search.solver import Solver
from hyperbit.controller.workspace.coverage import workspace_cells

Array = NDArray[np.float64]

POSITIONS = 400  # that the arm reaches without obstacles
FIRST, UNFOUND = 20.0, 200.0  # effort for a position, and for one that is not reached


class Obstructed(NamedTuple):
    """Positions that an arm reaches without obstacles, and what becomes of them among obstacles."""

    positions: Array  # in the world, shape (n, dimension)
    reached: NDArray[np.bool_]  # among the obstacles, shape (n,)
    proven: NDArray[np.bool_]  # whether a position that is not reached is proven to be out of reach, shape (n,)
    inside: dict[str, int]  # number of missed positions in each obstacle
    # number of other missed positions by what collides in a configuration that would reach them
    behind: dict[str, int]

    @property
    def error(self) -> float:
        """Standard error of the share of reached positions."""
        share, count = self.reached.mean(), len(self.reached)
        return float(np.sqrt(share * (1 - share) / count))


def obstructed(solver: Solver, radius: float, count: int = POSITIONS, seed: int = 0) -> Obstructed:
    """Returns a uniform sample of the positions that an arm reaches within a radius without its solver's obstacles.

    The searches are limited by work, so the figures are the same on every run.
    """
    arm, random, free = solver.manipulator, np.random.default_rng(seed), solver.avoiding(None)
    cells, home = workspace_cells(solver.densities, radius, arm.dimension), np.zeros(len(arm.modules), dtype=np.int64)
    allowed = SearchTime(FIRST * EFFORT, unfound=UNFOUND * EFFORT, by_work=True)
    positions, reached, proven = list[Array](), list[bool](), list[bool]()
    inside, behind = dict[str, int](), dict[str, int]()
    for local in cells.draw(20 * count, random):
        if len(positions) == count:
            break
        point = (arm.base[:3, :3] @ local + arm.base[:3, 3])[: arm.dimension]
        alone = free.solve(free.target(point, radius), home, timeout=allowed)
        if not alone.within_tolerance:
            continue
        found = solver.solve(solver.target(point, radius), alone.configuration, timeout=allowed)
        positions.append(point)
        reached.append(found.within_tolerance)
        proven.append(found.within_tolerance or found.certificate == "unreachable")
        if found.obstacle is not None:
            inside[found.obstacle] = inside.get(found.obstacle, 0) + 1
        elif not found.within_tolerance and solver.clearance is not None:
            cause = solver.clearance.cause(alone.configuration)
            behind[cause] = behind.get(cause, 0) + 1
    return Obstructed(np.array(positions), np.array(reached), np.array(proven), inside, behind)
