"""Collision-free stages of a transition, in any order and at any stroke of a stage's actuators.

An order of single actuators in which each switch is clear is cut into the fewest stages that are clear as a whole.
"""

from collections.abc import Sequence

import numpy as np

from hyperbit.controller.obstacles.distance import Index
from hyperbit.controller.obstacles.sweep import Collision, States, Sweep


class StageSequencer:
    """Finds collision-free stages from given actuator states. A stage lists the actuators (k,) that switch.

    Args:
        sweep: swept checks of the arm.
        states: actuator states before, shape (A,).
        most: actuators that may switch at once.
    """

    def __init__(self, sweep: Sweep, states: States, most: int) -> None:
        self._sweep, self._states, self._most = sweep, states, most
        self._obstruction: Collision | None = None
        self._checked: dict[tuple[bytes, bytes], bool] = {}

    @property
    def obstruction(self) -> str:
        """What the last rejected stage collides with, or may collide with, in words."""
        return "nothing" if self._obstruction is None else self._sweep.describe(self._obstruction)

    def clear(self, stages: Sequence[Index]) -> bool:
        """Returns whether consecutive stages are clear."""
        states = self._states
        for stage in stages:
            if not self._clear(states, stage):
                return False
            states = flipped(states, stage)
        return True

    def cut(self, order: Index) -> list[Index]:
        """Returns the fewest clear stages of actuators in an order; an empty list if one actuator alone collides."""
        stages, states, first = list[Index](), self._states, 0
        while first < len(order):
            rest = order[first : first + self._most]
            low, high = 0, next((k for k in range(1, len(rest)) if rest[k] in rest[:k]), len(rest))
            size = high
            while low < high:  # a part of a clear stage is clear
                if self._clear(states, rest[:size]):
                    low = size
                else:
                    high = size - 1
                size = (low + high + 1) // 2
            if low == 0:
                return []
            stages.append(rest[:low])
            states = flipped(states, rest[:low])
            first += low
        return stages

    def _clear(self, states: States, stage: Index) -> bool:
        key = states.tobytes(), np.sort(stage).tobytes()
        if key not in self._checked:
            collision = self._sweep.first_collision(states, stage)
            self._checked[key] = collision is None
            self._obstruction = collision or self._obstruction
        return self._checked[key]


def flipped(states: States, stage: Index) -> States:
    """Returns the states (A,) after a stage (k,)."""
    result = states.copy()
    result[stage] ^= 1
    return result
