"""What a search has come to."""

import math
from dataclasses import dataclass

from controller.manipulator.manipulator import Configuration

CLOSE = 1.0 - 1e-9  # of the tolerance: it is kept whatever the order of additions


@dataclass(frozen=True, eq=False)
class Found:
    """The best configuration so far.

    Attributes:
        configuration: shape (B,).
        cost: of its switches; infinite while none is within the tolerance.
        square: squared distance of its tip from the goal.
        bound: no configuration within the tolerance costs less.
    """

    configuration: Configuration
    cost: float
    square: float
    bound: float = 0.0

    @property
    def settled(self) -> bool:
        """Whether nothing better can be found."""
        return self.bound >= self.cost or self.bound == math.inf

    def better(self, other: "Found") -> "Found":
        """Returns the cheaper, or between equals the nearer; itself where they are alike."""
        return other if (other.cost, other.square) < (self.cost, self.square) else self
