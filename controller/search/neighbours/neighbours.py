"""Lists of configurations near others."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hyperbit.controller.obstacles.scene import Scene
from hyperbit.controller.search.neighbours.chain import Chain, Places
from hyperbit.controller.search.neighbours.changes import Found, room_for_changes
from hyperbit.controller.search.neighbours.listing import list_near

Array = NDArray[np.float64]
Integers = NDArray[np.int64]

LISTED, ROWS = 1 << 16, 1 << 12  # configurations and changes for which there is room at first
AT_ONCE, AT_ONCE_IN_PART = 512, 16  # those between two checks of the deadline, or of the number found

Late = Callable[[], bool]


class Pairs(NamedTuple):
    """Configurations near others."""

    sources: Integers  # number of the other, shape (n,)
    keys: Integers  # shape (n, words)
    costs: Array  # between the two, shape (n,)


class Neighbours:
    """Lists configurations near others for one thread; holds the memory for it."""

    def __init__(self, chain: Chain, places: Places, scene: Scene | None, most_rows: int, rows: int = ROWS) -> None:
        self.chain, self.places, self.scene, self._most_rows = chain, places, scene, most_rows
        self.changed, self._found = room_for_changes(chain, rows), self._room(LISTED)

    def _room(self, rows: int) -> Found:
        words = int(self.chain.words[-1]) + 1
        return Found(np.empty(rows, np.int64), np.empty((rows, words), np.int64), np.empty(rows), np.zeros(1, np.int64))

    def near(self, k: int, keys: Integers, budgets: Array, most: int, late: Late, part: bool = False) -> Pairs | None:
        """Returns configurations that serve point k within a budget (n,) of keys (n, words).

        Returns None if they are more than `most`, if `late()` becomes true, or if a budget is too large. With `part`,
        some `most` of them suffice.
        """
        if not len(keys):
            return Pairs(np.empty(0, np.int64), keys, budgets)
        parts, first, total = list[Pairs](), 0, 0
        while first < len(keys):
            self._found.written[0] = 0
            some = slice(first, first + (AT_ONCE_IN_PART if part else AT_ONCE))
            done = list_near(
                self.chain, self.places, k, self.scene, keys[some], budgets[some], self.changed, self._found
            )
            rows, count = len(self.changed.links), int(self._found.written[0])
            if done < 0:
                if rows >= self._most_rows:
                    return None
                self.changed = room_for_changes(self.chain, 4 * rows)
            elif count == 0 and done == 0:
                self._found = self._room(4 * len(self._found.sources))
            found = self._found
            parts.append(Pairs(found.sources[:count] + first, found.keys[:count].copy(), found.costs[:count].copy()))
            first, total = first + (done if done >= 0 else -done - 1), total + count
            if part and total >= most:
                break
            if total > most or (first < len(keys) and late()):
                return None
        return joined(parts)


def joined(parts: Sequence[Pairs]) -> Pairs:
    return Pairs(*(np.concatenate(arrays) for arrays in zip(*parts, strict=True)))
