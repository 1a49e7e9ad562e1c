"""Keep-out regions in the world: spheres, oriented boxes and half-spaces; those of the plane are the same at z = 0.

All are convex and closed.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from controller.obstacles.distance import BOX, HALF_SPACE, SPHERE, signed_distance

Array = NDArray[np.float64]
Index = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Regions:
    """Regions, one after the other.

    Attributes:
        names: as sentences call them, such as "disc 'pillar'".
        kinds: SPHERE, BOX or HALF_SPACE, shape (n,).
        axes: rows are the axes of a box; the first is a half-space's outward normal; shape (n, 3, 3).
        centres: of spheres and boxes, a point on the plane of a half-space, shape (n, 3).
        sizes: the radius of a sphere in the first place, half the sides of a box, shape (n, 3).
    """

    names: tuple[str, ...]
    kinds: Index
    axes: Array
    centres: Array
    sizes: Array

    def __len__(self) -> int:
        """How many there are."""
        return len(self.names)

    def depths(self, points: ArrayLike) -> Array:
        """Returns the signed distances (m, n) of points (m, 3) from each region, negative inside."""
        asked = np.ascontiguousarray(points, dtype=float).reshape(-1, 3)
        result = np.empty((len(asked), len(self)))
        for k in range(len(self)):
            for j, (x, y, z) in enumerate(asked):
                result[j, k] = signed_distance(self.kinds[k], self.axes[k], self.centres[k], self.sizes[k], x, y, z)
        return result


def sphere(name: str, centre: ArrayLike, radius: float) -> Regions:
    """Returns a sphere; with `centre` (2,) a disc of the plane z = 0."""
    return one(name, SPHERE, centre, [radius, 0.0, 0.0])


def box(name: str, centre: ArrayLike, size: ArrayLike, rotation: ArrayLike | None = None) -> Regions:
    """Returns a box with sides `size` along the columns of `rotation` (3, 3); with `size` (2,) one of the plane."""
    half = [*(np.asarray(size, dtype=float) / 2), np.inf][:3]
    return one(name, BOX, centre, half, np.eye(3) if rotation is None else np.asarray(rotation, dtype=float).T)


def half_space(name: str, point: ArrayLike, normal: ArrayLike) -> Regions:
    """Returns all that lies behind the plane through `point`: on the side that `normal` points away from."""
    outward = np.array([*np.asarray(normal, dtype=float), 0.0][:3])
    return one(name, HALF_SPACE, point, np.zeros(3), np.array([outward / np.linalg.norm(outward), *np.zeros((2, 3))]))


def one(name: str, kind: int, centre: ArrayLike, size: ArrayLike, axes: ArrayLike | None = None) -> Regions:
    """Returns a single region; `centre` of shape (2,) or (3,), the rest as in Regions."""
    point = np.array([[*np.asarray(centre, dtype=float), 0.0][:3]])
    own = np.eye(3) if axes is None else np.asarray(axes, dtype=float)
    return Regions((name,), np.array([kind]), own[None].copy(), point, np.array([size], dtype=float))


def together(parts: Sequence[Regions]) -> Regions:
    """Returns all regions of the parts, in their order; there may be none."""
    return Regions(
        tuple(name for part in parts for name in part.names),
        np.concatenate([np.empty(0, dtype=np.int64), *(part.kinds for part in parts)]),
        np.concatenate([np.empty((0, 3, 3)), *(part.axes for part in parts)]),
        np.concatenate([np.empty((0, 3)), *(part.centres for part in parts)]),
        np.concatenate([np.empty((0, 3)), *(part.sizes for part in parts)]),
    )


NONE = together([])
