"""The incumbent: the best configuration so far, the bound proven, the clock, and when to stop."""

import time

import numpy as np

from controller.manipulator.manipulator import Configuration

# Sums of the same weights differ by rounding: costs that differ by less than this part of them are equal.
EPSILON = 1e-9


def proves(bound: float, cost: float) -> bool:
    """Returns whether a lower bound proves that a cost is the least."""
    return bound >= cost * (1 - EPSILON)


class Incumbent:
    """The best configuration found for a goal. One search's.

    Attributes:
        configuration: shape (B,).
        cost: weighted switches; infinite while no configuration within the tolerances is known.
        square: its squared miss, see Target.
        bound: no configuration within the tolerances costs less; it never falls.
        until: `time.perf_counter()` at which the search ends, nearly.
    """

    def __init__(self, configuration: Configuration, until: float) -> None:
        self.configuration, self.until = configuration, until
        self.cost, self.square, self.bound = np.inf, np.inf, 0.0

    @property
    def settled(self) -> bool:
        """Whether nothing better can be found."""
        return proves(self.bound, self.cost)

    @property
    def late(self) -> bool:
        """Whether the time is over."""
        return time.perf_counter() > self.until

    @property
    def over(self) -> bool:
        """Whether to stop."""
        return self.settled or self.late

    def left(self) -> float:
        """Returns how much time is left [s]."""
        return self.until - time.perf_counter()

    def offer(self, configuration: Configuration, cost: float, square: float) -> bool:
        """Takes a configuration if it is cheaper, or as cheap and nearer; returns whether it was taken."""
        if (cost, square) < (self.cost, self.square):
            self.configuration, self.cost, self.square = configuration, cost, square
            return True
        return False

    def prove(self, bound: float) -> None:
        """Raises the bound, if it is below."""
        self.bound = max(self.bound, bound)
