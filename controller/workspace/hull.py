"""The hull of all tips: no configuration reaches a goal outside it."""

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from hyperbit.controller.manipulator.manipulator import Manipulator

Array = NDArray[np.float64]

SAMPLES = {2: 513, 3: 25}  # directions along an edge of the square or cube, by dimension


class Hull:
    """A convex hull that contains all tips, in frame F_0.

    The support function h(u) is the greatest coordinate of a tip along u. It obeys the recursion of the workspaces. If
    q is a tip in the frame above module i, the tip in the frame below is b + R q. So h(u) is the maximum of
    u b + h'(R^T u) over the states of the module. Support functions are convex and homogeneous: interpolation between
    sampled directions is an upper bound. So the hull may be too large, but never too small.

    Attributes:
        boxes: least and greatest x, least and greatest y, ... of the tips in frames F_0 to F_B, shape (B+1, 2 * size).
    """

    def __init__(self, manipulator: Manipulator) -> None:
        self._size = manipulator.dimension
        self._edge = np.linspace(-1.0, 1.0, SAMPLES[self._size])
        self._directions = self._surface()
        self._supports = np.zeros(len(self._directions))
        size, count = self._size, len(manipulator.modules)
        self.boxes = np.zeros((count + 1, 2 * size))
        along = np.concatenate([(-np.eye(size)[a], np.eye(size)[a]) for a in range(size)])
        for i in reversed(range(len(manipulator.modules))):
            k = manipulator.states[i]
            r, b = manipulator.rotations[i, :k, :size, :size], manipulator.translations[i, :k, :size]
            each = [self._directions @ b[j] + self._support(self._directions @ r[j]) for j in range(k)]
            self._supports = np.max(each, axis=0)
            self.boxes[i] = self._support(along) * np.tile((-1.0, 1.0), size)

    @property
    def reach(self) -> float:
        """About the greatest distance of a tip from the base, by the sampled directions."""
        return float((self._supports / np.linalg.norm(self._directions, axis=1)).max())

    def excludes(self, goal: Array, tolerance: float) -> bool:
        """Returns whether provably no tip is within the tolerance of a goal (3,) in frame F_0."""
        lengths = np.linalg.norm(self._directions, axis=1)
        excess = self._directions @ goal[: self._size] - self._supports
        return bool(np.any(excess > lengths * (tolerance + 1e-9 * (1 + np.abs(goal).max()))))

    def _surface(self) -> Array:
        """Returns directions (n, size) on the faces -x, +x, -y, ... of a cube, the first other coordinate slowest."""
        others = np.stack(np.meshgrid(*[self._edge] * (self._size - 1), indexing="ij"), axis=-1)
        others = others.reshape(-1, self._size - 1)
        faces = [np.insert(others, a, sign, axis=1) for a in range(self._size) for sign in (-1.0, 1.0)]
        return np.concatenate(faces)

    def _support(self, directions: Array) -> Array:
        """Returns upper bounds of the support function (n,) in directions (n, size)."""
        rows, side = np.arange(len(directions)), len(self._edge)
        axis = np.abs(directions).argmax(axis=1)
        length = np.abs(directions[rows, axis])
        face = 2 * axis + (directions[rows, axis] > 0)
        others = np.array([[b for b in range(self._size) if b != a] for a in range(self._size)])[axis]
        place = (np.take_along_axis(directions, others, axis=1) / length[:, None] + 1.0) * (side - 1) / 2
        low = np.clip(place.astype(np.int64), 0, side - 2)
        share = place - low
        total = np.zeros(len(directions))
        for corner in np.ndindex(*[2] * (self._size - 1)):
            weight = np.where(np.array(corner), share, 1.0 - share).prod(axis=1)
            index = face
            for a, step in enumerate(corner):
                index = index * side + low[:, a] + step
            total += weight * self._supports[index]
        return np.asarray(length * total)


@lru_cache(maxsize=2)  # shared by the solvers of goals and of set-points
def build_hull(manipulator: Manipulator) -> Hull:
    return Hull(manipulator)
