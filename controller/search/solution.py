"""What a search answers."""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from controller.manipulator.frames import Frame
from controller.manipulator.manipulator import Configuration
from controller.search.incumbent import proves

Certificate = Literal["optimal", "bound", "unreachable", "unknown"]


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
