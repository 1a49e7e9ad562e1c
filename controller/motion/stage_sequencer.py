"""The stages of a transition that touches nothing, in whatever order and mid-stroke the actuators of a stage are.

An order of actuators is sought that is clear one by one, and cut into the fewest stages that are clear as a whole.
Where no order serves, a roundabout way does, on which some actuators switch to and fro.
"""

import time
from collections.abc import Sequence
from heapq import heappop, heappush

import numpy as np

from controller.obstacles.distance import Index
from controller.obstacles.sweep import Collision, States, Sweep

DETOUR_TIME = 0.1  # [s] for one roundabout way


class StageSequencer:
    """StageSequencer from actuator states on, in stages of actuators (k,).

    Args:
        sweep: of the arm.
        states: of its actuators before, shape (A,).
        most: of them that may switch at once.
    """

    def __init__(self, sweep: Sweep, states: States, most: int) -> None:
        self._sweep, self._states, self._most = sweep, states, most
        self._blame: Collision | None = None
        self._seen: dict[tuple[bytes, bytes], bool] = {}

    @property
    def blame(self) -> str:
        """What the last stage looked at that is not clear touches, or may, in words."""
        return "nothing" if self._blame is None else self._sweep.describe(self._blame)

    def clear(self, stages: Sequence[Index]) -> bool:
        """Returns whether stages, one after the other, are clear."""
        states = self._states
        for stage in stages:
            if not self._clear(states, stage):
                return False
            states = flipped(states, stage)
        return True

    def cut(self, order: Index) -> list[Index]:
        """Returns the fewest clear stages of actuators in this order; none if there are none."""
        stages, states, first = list[Index](), self._states, 0
        while first < len(order):
            rest = order[first : first + self._most]
            low, high = 0, next((k for k in range(1, len(rest)) if rest[k] in rest[:k]), len(rest))
            size = high
            while low < high:  # what is clear as a whole is so in parts
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

    def order(self, end: States, fro: bool, patience: float) -> Index | None:
        """Returns actuators that lead to other states (A,) and are clear one by one; None if that is not found in time.

        They are sought from both ends, first where fewest are left to switch.

        Args:
            end: the other states.
            fro: whether an actuator may switch more than once.
            patience: time for it [s].
        """
        until, n = time.perf_counter() + patience, int(np.count_nonzero(self._states != end))
        ends = [self._states, end]
        ways: list[dict[bytes, list[int]]] = [{}, {}]
        heaps: list[list[tuple[float, int, int, bytes, list[int]]]] = [[], []]
        for side in (0, 1):
            heappush(heaps[side], (0.0, 0, 0, ends[side].tobytes(), []))
        count = 0
        while all(heaps) and time.perf_counter() < until:
            count += 1
            side = count % 2
            *_, code, way = heappop(heaps[side])
            here = np.frombuffer(code, dtype=np.uint8)
            if code in ways[side] or (way and not self._clear(flipped(here, np.array(way[-1:])), np.array(way[-1:]))):
                continue
            ways[side][code] = way
            if code in ways[1 - side]:
                return np.array(ways[0][code] + ways[1][code][::-1], dtype=np.int64)
            differ = here != ends[1 - side]
            options = np.arange(len(here)) if fro else np.flatnonzero(differ)
            following = np.repeat(here[None], len(options), axis=0)
            following[np.arange(len(options)), options] ^= 1
            for k in np.flatnonzero(~self._sweep.blocked(following)):
                left = int(differ.sum()) + (-1 if differ[options[k]] else 1)
                price = left + (len(way) + 1 + left - n) / 2  # what leads astray counts twice
                heappush(heaps[side], (price, left, -count, following[k].tobytes(), [*way, int(options[k])]))
        return None

    def _clear(self, states: States, stage: Index) -> bool:
        key = states.tobytes(), np.sort(stage).tobytes()
        if key not in self._seen:
            touch = self._sweep.first_collision(states, stage)
            self._seen[key] = touch is None
            self._blame = touch or self._blame
        return self._seen[key]


def flipped(states: States, stage: Index) -> States:
    """Returns the states (A,) after a stage (k,)."""
    result = states.copy()
    result[stage] ^= 1
    return result
