"""Figures of a long run, kept where they do not grow: periods of the control loop, memory of the process."""

import resource
import sys
from pathlib import Path

import numpy as np

from controller.daemon.loop import PERIOD
from controller.daemon.timekeeping import Timekeeper


class Periods:
    """The periods of every control loop in this process while the context lasts.

    Args:
        most: that are kept.
    """

    def __init__(self, most: int) -> None:
        self._seconds, self._count = np.zeros(most), 0

    def __enter__(self) -> "Periods":
        self._ticked = ticked = Timekeeper.ticked

        def noting(keeper: Timekeeper, began: float, ended: float) -> None:
            if self._count < len(self._seconds):
                self._seconds[self._count] = began - keeper._last
                self._count += 1
            ticked(keeper, began, ended)

        Timekeeper.ticked = noting  # type: ignore[method-assign]
        return self

    def __exit__(self, *_: object) -> None:
        Timekeeper.ticked = self._ticked  # type: ignore[method-assign]

    def clear(self) -> None:
        self._count = 0

    def seconds(self) -> np.ndarray:
        return self._seconds[: self._count]

    def figures(self) -> dict[str, float]:
        """How far periods were from nominal [s]."""
        off = np.abs(self.seconds() - PERIOD)
        return {
            "ticks": self._count,
            "median": float(np.median(off)),
            "99 %": float(np.quantile(off, 0.99)),
            "99.9 %": float(np.quantile(off, 0.999)),
            "worst": float(off.max()),
            "within 20 %": float(np.mean(off <= 0.2 * PERIOD)),
        }


class Memory:
    """Resident memory of this process and the number of Python's blocks in use.

    Both are read from outside: tracemalloc crashes a process whose kernels run without the interpreter's lock.

    Args:
        most: samples that are kept.
    """

    def __init__(self, most: int) -> None:
        self._samples, self._count = np.zeros((most, 2)), 0

    def sample(self) -> None:
        """Notes what is taken now."""
        if self._count < len(self._samples):
            resident = int(Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize()
            self._samples[self._count] = resident / 2**20, sys.getallocatedblocks()
            self._count += 1

    def end(self) -> dict[str, float]:
        """Returns figures after a fifth of the time and at its end, memory in MiB.

        Each is the least within a tenth of the time, since they swing with garbage that waits for its collection.
        """
        samples = self._samples[: self._count]
        tenth = max(self._count // 10, 1)
        warm, last = samples[2 * tenth : 3 * tenth].min(axis=0), samples[-tenth:].min(axis=0)
        figures = {"rss_warm": warm[0], "rss_end": last[0], "rss_growth": last[0] / warm[0] - 1}
        figures |= {"blocks_warm": warm[1], "blocks_end": last[1], "blocks_growth": last[1] / warm[1] - 1}
        return {name: float(value) for name, value in figures.items()}
