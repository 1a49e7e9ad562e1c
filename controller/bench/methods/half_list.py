"""The list of all configurations of half an arm within a number of switches, each with the image of a point."""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from hyperbit.controller.bench.methods.planar import Array, Index, Planar, moved
from hyperbit.controller.manipulator.manipulator import Configuration


class HalfList:
    """Memory for the list of one half, and its modules, in the order in which they move the point."""

    def __init__(self, arm: Planar, motions: Array, modules: Index, switches: int) -> None:
        self.modules = modules
        self.motions, self.states = np.ascontiguousarray(motions[modules]), arm.states[modules]
        rows = most_rows(arm.differing[modules], self.states, switches)
        self.points, self.prices = np.empty((rows, 2)), np.empty(rows, dtype=np.int8)
        self.codes, self.order = np.empty(rows, dtype=np.int64), np.empty(rows, dtype=np.int32)
        self.count = 0

    def list(self, start: tuple[float, float], costs: Index, switches: int) -> None:
        """Lists all configurations of the half within a number of switches."""
        own = np.ascontiguousarray(costs[self.modules])
        self.points[0] = start
        self.count = grow(self.motions, own, self.states, switches, self.points, self.prices, self.codes)
        by_price(self.prices, self.count, switches, self.order)

    def write(self, code: int, configuration: Configuration) -> None:
        """Writes the states of a row's code into a configuration (B,)."""
        for module, states in zip(self.modules[::-1], self.states[::-1], strict=True):
            code, configuration[module] = divmod(int(code), int(states))


def most_rows(differing: Index, states: Index, switches: int) -> int:
    """Returns an upper bound on the number of configurations within a number of switches of any configuration."""
    if np.prod(states.astype(float)) > 2**62:
        raise ValueError("half of the arm has more configurations than 64 bits can number")
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
    """Expands row 0, a point, into rows for all configurations with at most `most` switches; returns their number."""
    prices[0], codes[0], count = 0, 0, 1
    for i in range(len(states)):
        end = count
        for n in range(end):
            x, y, price, code = points[n, 0], points[n, 1], prices[n], codes[n] * states[i]
            for j in range(states[i]):
                cost = price + costs[i, j]
                if cost <= most:
                    row = n  # the previous state reuses the row
                    if costs[i, j] > 0:
                        row = count
                        count += 1
                    points[row, 0], points[row, 1] = moved(motions[i, j], x, y)
                    prices[row], codes[row] = cost, code + j
    return count


@njit("void(i1[::1], i8, i8, i4[::1])", cache=True, nogil=True)
def by_price(prices: NDArray[np.int8], count: int, most: int, order: NDArray[np.int32]) -> None:
    """Writes the order of the rows by price, cheapest first (counting sort)."""
    starts = np.zeros(most + 2, dtype=np.int64)
    for n in range(count):
        starts[prices[n] + 1] += 1
    for price in range(most):
        starts[price + 1] += starts[price]
    for n in range(count):
        order[starts[prices[n]]] = n
        starts[prices[n]] += 1
