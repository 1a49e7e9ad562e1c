"""Numbers of configurations within a cost of one, and the time that lists of them take."""

import numpy as np
from numpy.typing import NDArray

from hyperbit.controller.search.neighbours.chain import Chain

Array = NDArray[np.float64]

# Prices [s]: a configuration that is judged; the neighbours of one, among n configurations: 2 us + 10 ns * n^0.75, and
# 2 us for each of them that serves.
JUDGED, FOUND, FIRST_PRICE, PRICE, POWER = 0.6e-6, 2e-6, 2e-6, 10e-9, 0.75
JOINED, LOOKUP = 1.5e-6, 80e-9  # [s] of one of two lists that are joined, and of a change that is looked up
PARTS, DEEPEST = 4, 40  # steps of prices in a least weight; greatest budget with a price of its own


class Counts:
    """About how many configurations of the lowest modules are within a cost of one, and how long lists of them take."""

    def __init__(self, chain: Chain, modules: int) -> None:
        self._unit = chain.least / PARTS
        counts = np.zeros(PARTS * DEEPEST)
        counts[0] = 1.0
        for i, k in enumerate(chain.states[:modules].tolist()):
            following = np.zeros_like(counts)
            for shift in np.floor(chain.costs[i, 0, :k] / self._unit + 1e-6).astype(int).tolist():
                following[shift:] += counts[: len(counts) - shift] if shift < len(counts) else 0.0
            counts = following
        self._counts = np.cumsum(counts)
        self.all = float(np.prod(chain.states[:modules].astype(float)))

    def within(self, budget: float) -> float:
        """Returns the number within a budget."""
        at = int(min(budget / self._unit + 1e-6, len(self._counts)))
        return self.all if at == len(self._counts) else float(self._counts[at]) if at >= 0 else 0.0

    def prices(self, budgets: Array, share: float = 0.0) -> Array:
        """Returns the times [s] of lists of neighbours within budgets (...), a share of which serves a point."""
        at = np.clip(np.floor(budgets / self._unit + 1e-6), -1, len(self._counts) - 1).astype(int)
        counts = self._counts[at]
        return np.where(at < PARTS, JUDGED, FIRST_PRICE + PRICE * counts**POWER + FOUND * share * counts)

    def joins(self, budgets: Array, least: float) -> Array:
        """Returns the times [s] to find the pairs of a configuration in another list; of the lowest half of an arm."""
        lookups = [
            self._counts[np.clip(np.floor(most / self._unit + 1e-6), 0, len(self._counts) - 1).astype(int)]
            for most in (budgets / 2, (budgets - least) / 2)
        ]
        return np.asarray(JOINED + LOOKUP * (lookups[0] + lookups[1]))

    def affordable(self, price: float) -> float:
        """Returns the greatest budget whose list takes at most a time [s]."""
        most = (max(price - FIRST_PRICE, 0.0) / PRICE) ** (1 / POWER)
        return self._unit * max(int(np.searchsorted(self._counts, most, side="right")) - 1, PARTS)
