"""The nearest configuration, where none is known within the tolerance: cost plays no part."""

import math
import time
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from controller.manipulator.manipulator import Manipulator
from controller.search.criteria import distances
from controller.search.frame_rows import motions
from controller.search.incumbent import Incumbent
from controller.search.scene import collides
from controller.search.segment import Storage, build_segment
from controller.search.target import Target
from controller.search.two_list import TwoList, rows

Array = NDArray[np.float64]

ROWS = 1 << 14
GRID = {2: 256, 3: 32}  # pairs are looked for as near as the points' extent over so many


class Nearest:
    """Brings the tip nearer from a configuration on, by changes of few actuators at a time.

    Args:
        manipulator: the arm.
        two: memory that may be overwritten.
    """

    def __init__(self, manipulator: Manipulator, two: TwoList) -> None:
        self._m, self._motions, self._two = manipulator, motions(manipulator), two
        self._free = np.zeros(manipulator.bits.shape[:2])
        self._storage = Storage(rows(manipulator, 0, len(manipulator.modules), ROWS), self._motions.shape[1])

    def claim(self) -> None:
        """Has the system hand out all memory now, not in the middle of a search with a deadline."""
        self._storage.claim()

    def improve(self, target: Target, incumbent: Incumbent) -> None:
        """Offers nearer configurations to an incumbent of infinite cost until its time is over, nearly."""
        seconds = 0.0
        while incumbent.left() > 1.5 * seconds:
            began, before = time.perf_counter(), incumbent.square
            self._change(target, incumbent)
            self._pair(target, incumbent)
            seconds = time.perf_counter() - began
            if incumbent.square >= before * (1 - 1e-9):
                break

    def _change(self, target: Target, incumbent: Incumbent) -> None:
        """Offers the nearest of all that differ in few actuators, wherever they are."""
        seed = incumbent.configuration
        away = distances(self._m, seed)
        count = len(self._m.modules)
        segment = build_segment(self._motions, self._m.states, self._storage, seed, away, self._free, 0, count)
        squares = target.squares(segment.frames)
        nearer = np.flatnonzero(squares < incumbent.square)
        for row in nearer[np.argsort(squares[nearer])].tolist():
            configuration = seed.copy()
            segment.write(row, configuration)
            if target.scene is None or not collides(target.scene, configuration):
                incumbent.offer(configuration, np.inf, float(squares[row]))
                return

    def _pair(self, target: Target, incumbent: Incumbent) -> None:
        """Offers the nearest of all that differ in few actuators of either half, if it is very near."""
        two, size = self._two, self._m.dimension
        two.list(incumbent.configuration, distances(self._m, incumbent.configuration), self._free, ROWS)
        extent = float(np.ptp(two.upper.frames[:, :size], axis=0).max())
        within = min(float(np.sqrt(incumbent.square)), extent / GRID[size])
        if within == 0.0:
            return
        near = Incumbent(incumbent.configuration, incumbent.until)
        near.offer(incumbent.configuration, 0.0, incumbent.square)
        two.match(replace(target, tolerance=within, turn=math.inf), near)
        incumbent.offer(near.configuration, np.inf, near.square)
