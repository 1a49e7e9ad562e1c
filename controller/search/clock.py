"""The clock of a search: seconds, or work. By work, an answer is the same on every run and on every busy computer.

The search charges the clock for each part of its work, at a fixed price. A price is the usual time of the part on an
ordinary computer, so that deadlines have the same meaning by both clocks. A price must not depend on what an earlier
search has left: lists and maps that are ready cost as much as new ones.
"""

import time

EFFORT = 1e-3  # [s] on an ordinary computer for one unit of effort

# Prices [s]
START = 0.3e-3  # the beginning of a search
LISTED = 40e-9  # a row of a list
INDEXED = 40e-9  # a row of an index, or eight of its cells
NEIGHBOUR = 0.15e-6  # a change, of those that cost half as much as the neighbours that are listed
CHANGED = 350e-9  # a changed configuration whose distance is computed
COMPARED = 2.5e-9  # a comparison of matching, see matching.kernel
NODE = 150e-9  # a node of branch and bound
MAPS = 4e-3  # the cost-to-go maps of one start: they have nearly the same number of look-ups for all arms
DESCENT = 0.6e-3  # a descent by the densities, with its search of the distal table
GROWN = 10e-9  # a child of a beam search
FINISHED = 0.1e-3  # the search of the distal table for a node of a beam
CHECKED = 0.7e-6  # a collision check of such a search


class WallClock:
    """Time as it passes."""

    def now(self) -> float:
        """Returns the time [s]."""
        return time.perf_counter()

    def charge(self, price: float) -> None:
        """Does nothing: time passes by itself."""

    def expected(self, measured: float, price: float) -> float:
        """Returns the expected time of a part of the work [s], as it was measured before."""
        return measured


class WorkClock:
    """Work since the start of one search."""

    def __init__(self) -> None:
        self._spent = 0.0

    def now(self) -> float:
        """Returns the work so far, as time on an ordinary computer [s]."""
        return self._spent

    def charge(self, price: float) -> None:
        """Counts a part of the work at its price [s]."""
        self._spent += price

    def expected(self, measured: float, price: float) -> float:
        """Returns the price of a part of the work [s]: a measurement would depend on the computer."""
        return price


Clock = WallClock | WorkClock
WALL = WallClock()
