"""Half an arm: its configurations within so many switches of the previous one, each as where it takes a point."""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from controller.bench.methods.planar import Array, Index, Planar, moved
from controller.manipulator.manipulator import Configuration


class Half:
    """Memory for the rows of one half, and the modules that it has, in the order in which they move its point."""

    def __init__(self, arm: Planar, motions: Array, modules: Index, switches: int) -> None:
        self.modules = modules
        self.motions, self.states = np.ascontiguousarray(motions[modules]), arm.states[modules]
        rows = most_rows(arm.differing[modules], self.states, switches)
        self.points, self.prices = np.empty((rows, 2)), np.empty(rows, dtype=np.int8)
        self.codes, self.order = np.empty(rows, dtype=np.int64), np.empty(rows, dtype=np.int32)
        self.count = 0

    def list(self, start: tuple[float, float], costs: Index, switches: int) -> None:
        """Fills the rows with every configuration within so many switches."""
        own = np.ascontiguousarray(costs[self.modules])
        self.points[0] = start
        self.count = grow(self.motions, own, self.states, switches, self.points, self.prices, self.codes)
        by_price(self.prices, self.count, switches, self.order)

    def write(self, code: int, configuration: Configuration) -> None:
        """Puts the states that a row's code stands for in a configuration (B,)."""
        for module, states in zip(self.modules[::-1], self.states[::-1], strict=True):
            code, configuration[module] = divmod(int(code), int(states))


def most_rows(differing: Index, states: Index, switches: int) -> int:
    """Returns an upper bound of the configurations within so many switches of any."""
    if np.prod(states.astype(float)) > 2**62:
        raise ValueError("a half of the arm has more configurations than a code of 64 bits tells apart")
    total = np.eye(1, switches + 1, dtype=np.int64)[0]
    for module, k in zip(differing, states, strict=True):
        counts = np.max([np.bincount(row[:k], minlength=switches + 1) for row in module[:k]], axis=0)
        total = np.convolve(total, counts)[: switches + 1]
    return int(total.sum())


@njit(
    "i8(f8[:,:,::1], i8[:,::1], i8[::1], i8, f8[:,::1], i1[::1], i8[::1])", cache=True, nogil=True, error_model="numpy"
)
def grow(
    motions: Array, costs: Index, states: Index, most: int, points: Array, prices: NDArray[np.int8], codes: Index
) -> int:
    """Turns row 0, a point, into rows for all configurations of at most `most` switches; returns their number."""
    prices[0], codes[0], count = 0, 0, 1
    for i in range(len(states)):
        end = count
        for n in range(end):
            x, y, price, code = points[n, 0], points[n, 1], prices[n], codes[n] * states[i]
            for j in range(states[i]):
                cost = price + costs[i, j]
                if cost <= most:
                    row = n  # the state of before goes on in the row itself
                    if costs[i, j] > 0:
                        row = count
                        count += 1
                    points[row, 0], points[row, 1] = moved(motions[i, j], x, y)
                    prices[row], codes[row] = cost, code + j
    return count


@njit("void(i1[::1], i8, i8, i4[::1])", cache=True, nogil=True)
def by_price(prices: NDArray[np.int8], count: int, most: int, order: NDArray[np.int32]) -> None:
    """Writes the rows' order, cheapest first."""
    starts = np.zeros(most + 2, dtype=np.int64)
    for n in range(count):
        starts[prices[n] + 1] += 1
    for price in range(most):
        starts[price + 1] += starts[price]
    for n in range(count):
        order[starts[prices[n]]] = n
        starts[prices[n]] += 1
