"""The incumbent of a search, the solution that it answers, and what is proven of it."""

import time
from dataclasses import dataclass
from typing import Literal

import numpy as np

from controller.manipulator.frames import Frame
from controller.manipulator.manipulator import Configuration

Certificate = Literal["optimal", "bound", "unreachable", "unknown"]

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


@dataclass(frozen=True, eq=False)
class Solution:
    """What a search found for one goal.

    Attributes:
        configuration: module states, base first, shape (B,).
        tip: the frame it brings the tip to, in the world, shape (4, 4).
        error: distance of the tip from the goal.
        switches: actuators that differ from the previous configuration; those switched, if the path is roundabout.
        within_tolerance: whether error and angle are within the tolerances, and the arm touches nothing that it is to
            keep clear of.
        seconds: time the search took.
        cost: weighted number of switches.
        bound: proven: no clear configuration within the tolerances costs less; infinite if there is none at all; 0 if
            nothing is proven.
        angle: between the tip's orientation and the goal's [rad]; 0 if any will do.
        clear: whether the arm touches nothing that it is to keep clear of; if not, nothing clear was found at all.
    """

    configuration: Configuration
    tip: Frame
    error: float
    switches: int
    within_tolerance: bool
    seconds: float
    cost: float
    bound: float = 0.0
    angle: float = 0.0
    clear: bool = True

    @property
    def certificate(self) -> Certificate:
        """What is proven: the cost is the least; it is at least `bound`; no configuration serves; or nothing."""
        return certificate(self.within_tolerance, self.bound, self.cost)

    @property
    def optimal(self) -> bool | None:
        """Whether it is proven that no clear configuration within the tolerances costs less; None if unknown."""
        return None if self.certificate == "unknown" else self.certificate == "optimal"

    @property
    def lower_bound(self) -> float | None:
        """The bound, infinite if the goal is unreachable; None if nothing is proven."""
        return None if self.certificate == "unknown" else self.bound

    def proof(self) -> dict[str, str | bool | float | None]:
        """Returns what is proven as fields for JSON."""
        return proof(self.certificate, self.bound)


def certificate(served: bool, bound: float, cost: float) -> Certificate:
    """Returns what a lower bound proves of a cost; `served`: the cost is that of something that serves."""
    if served and proves(bound, cost):
        return "optimal"
    if bound == np.inf:
        return "unreachable"
    return "bound" if bound > 0 else "unknown"


def proof(kind: Certificate, bound: float) -> dict[str, str | bool | float | None]:
    """Returns the fields `optimal`, `lower_bound` and `certificate` for JSON, which has no infinity."""
    known = kind in ("optimal", "bound")
    optimal = None if kind == "unknown" else kind == "optimal"
    return {"optimal": optimal, "lower_bound": bound if known else None, "certificate": kind}
