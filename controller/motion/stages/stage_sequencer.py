"""Collision-free stages of a transition, in any order and at any stroke of a stage's actuators.

An order of single actuators is searched in which each switch is clear. The order is cut into the fewest stages that are
clear as a whole. If there is no such order, a detour is searched, on which some actuators switch back and forth.
"""

from collections.abc import Callable, Sequence
from heapq import heappop, heappush

import numpy as np

from controller.obstacles.distance import Index
from controller.obstacles.sweep import Collision, States, Sweep

Late = Callable[[], bool]  # returns whether the time of a search is over; what it raises ends the planning


class StageSequencer:
    """Finds collision-free stages from given actuator states. A stage lists the actuators (k,) that switch.

    Attributes:
        enclosed: all actuator states (n, A) that can be reached, if a search has found that the end is none of them.

    Args:
        sweep: swept checks of the arm.
        states: actuator states before, shape (A,).
        most: actuators that may switch at once.
    """

    def __init__(self, sweep: Sweep, states: States, most: int) -> None:
        self._sweep, self._states, self._most = sweep, states, most
        self._obstruction: Collision | None = None
        self._checked: dict[tuple[bytes, bytes], bool] = {}
        self.enclosed: States | None = None

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

    def order(self, end: States, repeats: bool, late: Late) -> Index | None:
        """Returns an order of actuators (n,) in which each switch is clear; None if none is found in time.

        Best-first search from both ends. The estimate is the number of actuators that have yet to switch.

        Args:
            end: actuator states after, shape (A,).
            repeats: an actuator may switch more than once.
            late: called before each step.
        """
        n = int(np.count_nonzero(self._states != end))
        ends = [self._states, end]
        paths: list[dict[bytes, list[int]]] = [{}, {}]
        heaps: list[list[tuple[float, int, int, bytes, list[int]]]] = [[], []]
        for side in (0, 1):
            heappush(heaps[side], (0.0, 0, 0, ends[side].tobytes(), []))
        count = 0
        while heaps[0] and not late():
            count += 1
            side = count % 2 if heaps[1] else 0  # without a way to the end, all that can be reached is found
            *_, code, path = heappop(heaps[side])
            here = np.frombuffer(code, dtype=np.uint8)
            last = np.array(path[-1:], dtype=np.int64)
            if code in paths[side] or (path and not self._clear(flipped(here, last), last, clear_ends=True)):
                continue
            paths[side][code] = path
            if code in paths[1 - side]:
                return np.array(paths[0][code] + paths[1][code][::-1], dtype=np.int64)
            differ = here != ends[1 - side]
            options = np.arange(len(here)) if repeats else np.flatnonzero(differ)
            following = np.repeat(here[None], len(options), axis=0)
            following[np.arange(len(options)), options] ^= 1
            for k in np.flatnonzero(~self._sweep.blocked(following)):
                remaining = int(differ.sum()) + (-1 if differ[options[k]] else 1)
                estimate = remaining + (len(path) + 1 + remaining - n) / 2  # a switch away from the end counts twice
                heappush(heaps[side], (estimate, remaining, -count, following[k].tobytes(), [*path, int(options[k])]))
        if repeats and not heaps[0]:  # any clear stage can be cut into clear switches, one after the other
            self.enclosed = np.array([np.frombuffer(code, dtype=np.uint8) for code in paths[0]])
        return None

    def _clear(self, states: States, stage: Index, *, clear_ends: bool = False) -> bool:
        key = states.tobytes(), np.sort(stage).tobytes()
        if key not in self._checked:
            collision = self._sweep.first_collision(states, stage, clear_ends=clear_ends)
            self._checked[key] = collision is None
            self._obstruction = collision or self._obstruction
        return self._checked[key]


def flipped(states: States, stage: Index) -> States:
    """Returns the states (A,) after a stage (k,)."""
    result = states.copy()
    result[stage] ^= 1
    return result
