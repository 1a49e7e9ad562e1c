"""Obstacles in the world: spheres, oriented boxes and half-spaces, all convex and closed.

A disc, rectangle or half-plane is a sphere, box or half-space with its centre at z = 0.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hyperbit.controller.obstacles.distance import BOX, HALF_SPACE, SPHERE, signed_distance

Array = NDArray[np.float64]
Index = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Obstacles:
    """Obstacles, one after the other."""

    names: tuple[str, ...]  # for messages, such as "disc 'pillar'"
    kinds: Index  # SPHERE, BOX or HALF_SPACE, shape (n,)
    axes: Array  # the rows are the axes of a box; the first row is the outward normal of a half-space; shape (n, 3, 3)
    centres: Array  # centres of spheres and boxes, or a point on the plane of a half-space, shape (n, 3)
    sizes: Array  # half the sides of a box; a sphere has its radius in the first column; shape (n, 3)

    def __len__(self) -> int:
        return len(self.names)

    def depths(self, points: ArrayLike) -> Array:
        """Returns the signed distances (m, n) of points (m, 3) from each obstacle, negative inside."""
        asked = np.ascontiguousarray(points, dtype=float).reshape(-1, 3)
        result = np.empty((len(asked), len(self)))
        for k in range(len(self)):
            for j, (x, y, z) in enumerate(asked):
                result[j, k] = signed_distance(self.kinds[k], self.axes[k], self.centres[k], self.sizes[k], x, y, z)
        return result


def sphere(name: str, centre: ArrayLike, radius: float) -> Obstacles:
    """Returns a sphere, or a disc if `centre` has shape (2,)."""
    return one(name, SPHERE, centre, [radius, 0.0, 0.0])


def box(name: str, centre: ArrayLike, size: ArrayLike, rotation: ArrayLike | None = None) -> Obstacles:
    """Returns a box with sides `size` along the columns of `rotation` (3, 3), or a rectangle if `size` is (2,)."""
    half = [*(np.asarray(size, dtype=float) / 2), np.inf][:3]
    return one(name, BOX, centre, half, np.eye(3) if rotation is None else np.asarray(rotation, dtype=float).T)


def half_space(name: str, point: ArrayLike, normal: ArrayLike) -> Obstacles:
    """Returns the half-space behind the plane through `point`; `normal` points out of it."""
    outward = np.array([*np.asarray(normal, dtype=float), 0.0][:3])
    return one(name, HALF_SPACE, point, np.zeros(3), np.array([outward / np.linalg.norm(outward), *np.zeros((2, 3))]))


def one(name: str, kind: int, centre: ArrayLike, size: ArrayLike, axes: ArrayLike | None = None) -> Obstacles:
    """Returns a single obstacle with `centre` (2,) or (3,); for the rest see Obstacles."""
    point = np.array([[*np.asarray(centre, dtype=float), 0.0][:3]])
    own = np.eye(3) if axes is None else np.asarray(axes, dtype=float)
    return Obstacles((name,), np.array([kind]), own[None].copy(), point, np.array([size], dtype=float))


def together(parts: Sequence[Obstacles]) -> Obstacles:
    """Returns the obstacles of all parts, in their order; no parts give no obstacles."""
    return Obstacles(
        tuple(name for part in parts for name in part.names),
        np.concatenate([np.empty(0, dtype=np.int64), *(part.kinds for part in parts)]),
        np.concatenate([np.empty((0, 3, 3)), *(part.axes for part in parts)]),
        np.concatenate([np.empty((0, 3)), *(part.centres for part in parts)]),
        np.concatenate([np.empty((0, 3)), *(part.sizes for part in parts)]),
    )


NONE = together([])
