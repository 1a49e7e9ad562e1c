"""Many cheap configurations for a goal, for those who choose among them."""

import numpy as np
from numpy.typing import NDArray

from controller.manipulator.manipulator import Configuration, Manipulator
from controller.search.frame_rows import fixed
from controller.search.matching import Found, match, whole
from controller.search.target import Target
from controller.search.two_list import TwoList, write

Array = NDArray[np.float64]

ROWS = 1 << 12  # of each half


class Candidates:
    """The cheapest configurations near a given one, with the memory to find them.

    Args:
        manipulator: the arm.
        most: how many to find at most.
    """

    def __init__(self, manipulator: Manipulator, most: int) -> None:
        self._two, self._most = TwoList(manipulator, ROWS), most

    def find(self, target: Target, seed: Configuration, costs: Array) -> tuple[NDArray[np.int64], Array]:
        """Returns configurations (n, B) whose tips are within the tolerances and clear, and what they cost (n,).

        Args:
            target: in frame F_0.
            seed: the configuration that costs nothing, shape (B,).
            costs: of every state of every module, shape (B, Kmax).
        """
        two = self._two
        two.list(seed, costs, costs)
        lower, goal, index = two.lower.side(), fixed(target.row), two.index(target.radius, target.chord)
        room = self._most
        found = Found(np.full((room, 3), -1), np.full(room, np.inf), np.full(room, np.inf))
        match(lower, goal, index, whole(lower, goal), target.query, seed, target.scene, found)
        chosen = np.flatnonzero(found.rows[:, 0] >= 0)
        configurations = np.tile(seed, (len(chosen), 1))
        for configuration, row in zip(configurations, found.rows[chosen].tolist(), strict=True):
            for side, n in zip((lower, goal, index.side), row, strict=True):
                write(side, n, configuration)
        return configurations, found.costs[chosen]
