"""The nearest configuration, where none is known within the tolerance: cost plays no part."""

import math
import time
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from controller.manipulator.manipulator import Manipulator
from controller.search.found import Found
from controller.search.frame_rows import motions
from controller.search.guard import first_clear, part
from controller.search.halves import Halves, rows
from controller.search.segment import Storage, build_segment
from controller.search.target import Target

Array = NDArray[np.float64]

ROWS = 1 << 14
GRID = {2: 256, 3: 32}  # pairs are looked for as near as the points' extent over so many


class Nearest:
    """Brings the tip nearer from a configuration on, by changes of few actuators at a time.

    Args:
        manipulator: the arm.
        halves: memory that may be overwritten.
    """

    def __init__(self, manipulator: Manipulator, halves: Halves) -> None:
        self._m, self._motions, self._halves = manipulator, motions(manipulator), halves
        self._free = np.zeros(manipulator.bits.shape[:2])
        self._storage = Storage(rows(manipulator, 0, len(manipulator.modules), ROWS), self._motions.shape[1])

    def claim(self) -> None:
        """Has the system hand out all memory now, not in the middle of a search with a deadline."""
        self._storage.claim()

    def improve(self, target: Target, best: Found, until: float) -> Found:
        """Returns the nearest configuration found; of infinite cost, as the one given.

        Args:
            target: in frame F_0.
            best: to begin with.
            until: `time.perf_counter()` at which to be done, nearly.
        """
        seconds = 0.0
        while (began := time.perf_counter()) + 1.5 * seconds < until:
            better = self._paired(target, self._changed(target, best), until)
            seconds = time.perf_counter() - began
            if better.square >= best.square * (1 - 1e-9):
                break
            best = better
        return best

    def _distances(self, best: Found) -> Array:
        own = self._m.bits[np.arange(len(best.configuration)), best.configuration]
        return np.asarray((self._m.bits != own[:, None]).sum(axis=2), dtype=float)

    def _changed(self, target: Target, best: Found) -> Found:
        """Returns the nearest of all that differ in few actuators, wherever they are."""
        segment = build_segment(
            self._motions,
            self._m.states,
            self._storage,
            best.configuration,
            self._distances(best),
            self._free,
            0,
            len(self._m.modules),
        )
        squares = target.squares(segment.frames)
        row = int(squares.argmin())
        if target.guard is not None:
            nearer = np.flatnonzero(squares < best.square)
            nearer = nearer[np.argsort(squares[nearer])]
            first = first_clear(target.guard, best.configuration, part(segment, nearer))
            row = nearer[first] if first >= 0 else -1
        if row < 0 or squares[row] >= best.square:
            return best
        configuration = best.configuration.copy()
        segment.write(row, configuration)
        return Found(configuration, np.inf, float(squares[row]))

    def _paired(self, target: Target, best: Found, until: float) -> Found:
        """Returns the nearest of all that differ in few actuators of either half, if it is very near."""
        halves, size = self._halves, self._m.dimension
        halves.list(best.configuration, self._distances(best), self._free, ROWS)
        extent = float(np.ptp(halves.upper.frames[:, :size], axis=0).max())
        within = min(float(np.sqrt(best.square)), extent / GRID[size])
        if within == 0.0:
            return best
        anyhow = replace(target, tolerance=within, turn=math.inf)
        found = halves.meet(anyhow, Found(best.configuration, 0.0, best.square), until)
        return Found(found.configuration, np.inf, found.square)
