"""The stages of a transition that touches nothing, in whatever order and mid-stroke the actuators of a stage are.

An order of actuators is sought that is clear one by one, and cut into the fewest stages that are clear as a whole.
"""

import time
from collections.abc import Sequence

import numpy as np

from controller.obstacles.gaps import Index
from controller.obstacles.sweep import States, Sweep, Touch

PATIENCE = 0.1  # [s] for one transition


class Ways:
    """Ways through the subsets of the actuators that switch, as masks of those that have.

    Args:
        sweep: of the arm.
        states: of its actuators before, shape (A,).
        actuators: that switch, shape (n,).
        most: of them that may switch at once.
    """

    def __init__(self, sweep: Sweep, states: States, actuators: Index, most: int) -> None:
        self._blame: Touch | None = None
        self._sweep, self._states, self._actuators = sweep, states, actuators
        self._most, self._until = most, time.perf_counter() + PATIENCE
        self._seen: dict[tuple[int, int], bool] = {}

    @property
    def blame(self) -> str:
        """What the last stage looked at that is not clear touches, or may, in words."""
        return "" if self._blame is None else self._sweep.words(self._blame)

    def clear(self, stages: Sequence[Index]) -> bool:
        """Returns whether stages, one after the other and each of actuators counted among those that switch, are."""
        done = 0
        for stage in stages:
            if not self._clear(done, stage):
                return False
            done |= mask(stage)
        return True

    def cut(self, order: Index) -> list[Index]:
        """Returns the fewest clear stages of actuators in this order; none if there are none."""
        stages, done, first = list[Index](), 0, 0
        while first < len(order):
            low, high = 0, min(self._most, len(order) - first)
            size = high
            while low < high:  # what is clear as a whole is so in parts
                if self._clear(done, order[first : first + size]):
                    low = size
                else:
                    high = size - 1
                size = (low + high + 1) // 2
            if low == 0:
                return []
            stages.append(order[first : first + low])
            done |= mask(stages[-1])
            first += low
        return stages

    def order(self, wanted: Index) -> Index | None:
        """Returns an order that is clear one by one, where it may be as wanted (n,); None if none is found."""
        path, done, tried = list[int](), 0, [iter(wanted)]
        dead = set[int]()
        while len(path) < len(wanted):
            for a in tried[-1]:
                following = done | 1 << int(a)
                if following != done and following not in dead and self._clear(done, np.array([a])):
                    path.append(int(a))
                    done = following
                    tried.append(iter(wanted))
                    break
            else:
                dead.add(done)
                tried.pop()
                if not path or time.perf_counter() > self._until:
                    return None
                done ^= 1 << path.pop()
        return np.array(path)

    def _clear(self, done: int, stage: Index) -> bool:
        key = done, mask(stage)
        if key not in self._seen:
            if self._seen and time.perf_counter() > self._until:
                return False
            states = self._states.copy()
            states[self._actuators[[k for k in range(len(self._actuators)) if done >> k & 1]]] ^= 1
            touch = self._sweep.touch(states, self._actuators[stage])
            self._seen[key] = touch is None
            self._blame = touch or self._blame
        return self._seen[key]


def mask(stage: Index) -> int:
    """Returns a stage as a mask."""
    return sum(1 << int(a) for a in stage)
