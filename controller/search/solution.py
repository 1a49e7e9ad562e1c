"""What a search answers."""

from dataclasses import dataclass

from controller.manipulator.frames import Frame
from controller.manipulator.manipulator import Configuration


@dataclass(frozen=True, eq=False)
class Solution:
    """What a search found for one goal.

    Attributes:
        configuration: module states, base first, shape (B,).
        tip: the frame it brings the tip to, in the world, shape (4, 4).
        error: distance of the tip from the goal.
        switches: actuators that differ from the previous configuration; those switched, where the way is roundabout.
        within_tolerance: whether error and angle are within the tolerances asked for, and the arm touches nothing that
            it is to keep clear of.
        seconds: time the search took.
        cost: weighted number of switches.
        lower_bound: no clear configuration within the tolerance costs less; infinite where there is proven to be none.
        angle: between the tip's orientation and the goal's [rad]; 0 where any will do.
        clear: whether it touches nothing that the arm is to keep clear of; if not, nothing clear was found at all.
    """

    configuration: Configuration
    tip: Frame
    error: float
    switches: int
    within_tolerance: bool
    seconds: float
    cost: float
    lower_bound: float = 0.0
    angle: float = 0.0
    clear: bool = True

    @property
    def optimal(self) -> bool:
        """Whether it is proven that no clear configuration within the tolerance costs less."""
        return self.within_tolerance and self.lower_bound >= self.cost * (1 - 1e-9)  # sums of weights are rounded
