"""Pictures of obstacles, behind the arms."""

from __future__ import annotations

from itertools import pairwise, product
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from hyperbit.controller.obstacles.distance import BOX, SPHERE
from hyperbit.controller.obstacles.obstacles import Obstacles

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Array = NDArray[np.float64]

COLOUR = "#8C2D04"
NAMED = "keep out"  # in the legend
FACES = ((0, 1, 3, 2), (4, 5, 7, 6), (0, 1, 5, 4), (2, 3, 7, 6), (0, 2, 6, 4), (1, 3, 7, 5))  # of CORNERS
CORNERS = np.array(list(product((-1.0, 1.0), repeat=3)))


def draw_obstacles(axes: Axes, obstacles: Obstacles, low: Array, high: Array) -> None:
    """Draws planar obstacles as hatched patches; half-planes end at the corners (2,) of the axes."""
    from matplotlib.patches import Circle, Patch, Polygon

    style: dict[str, Any] = {"facecolor": COLOUR + "30", "edgecolor": COLOUR, "hatch": "///", "linewidth": 1.0}
    for k in range(len(obstacles)):
        centre, size = obstacles.centres[k, :2], obstacles.sizes[k]
        patch: Patch
        if obstacles.kinds[k] == SPHERE:
            patch = Circle((centre[0], centre[1]), size[0])
        elif obstacles.kinds[k] == BOX:
            around = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
            patch = Polygon(centre + (around * size[:2]) @ obstacles.axes[k, :2, :2])
        else:
            corners = np.array([low, [high[0], low[1]], high, [low[0], high[1]]])
            behind = cut(corners, obstacles.centres[k, :2], obstacles.axes[k, 0, :2])
            if len(behind) < 3:
                continue
            patch = Polygon(behind)
        patch.set(**style, label="" if axes.get_legend_handles_labels()[1][-1:] == [NAMED] else NAMED, zorder=1)
        axes.add_patch(patch)


def draw_spatial_obstacles(axes: Any, obstacles: Obstacles, low: Array, high: Array) -> None:
    """Draws spatial obstacles as translucent bodies; half-spaces as planes within the corners (3,) of the axes."""
    from mpl_toolkits.mplot3d.art3d import Poly3DCollection  # type: ignore[import-untyped]

    for k in range(len(obstacles)):
        centre, size = obstacles.centres[k], obstacles.sizes[k]
        if obstacles.kinds[k] == SPHERE:
            faces = ball(centre, size[0])
        elif obstacles.kinds[k] == BOX:
            corners = centre + (CORNERS * size) @ obstacles.axes[k]
            faces = [corners[list(face)] for face in FACES]
        else:
            faces = [across(low, high, centre, obstacles.axes[k, 0])]
        faces = [face for face in faces if len(face) >= 3]
        label = "" if axes.get_legend_handles_labels()[1][-1:] == [NAMED] else NAMED
        if faces:
            shape = Poly3DCollection(
                faces, facecolors=COLOUR + "30", edgecolors=COLOUR + "60", linewidths=0.4, zorder=1
            )
            shape.set_label(label)
            axes.add_collection3d(shape)


def cut(corners: Array, point: Array, normal: Array) -> Array:
    """Returns the part of a convex polygon (n, d) that lies behind a plane through a point."""
    above, kept = (corners - point) @ normal, list[Array]()
    for (here, there), (a, b) in zip(
        pairwise([*corners, corners[0]]), pairwise([*above.tolist(), float(above[0])]), strict=True
    ):
        if a <= 0:
            kept.append(here)
        if a * b < 0:
            kept.append(here + (there - here) * (a / (a - b)))
    return np.array(kept)


def across(low: Array, high: Array, point: Array, normal: Array) -> Array:
    """Returns the intersection of a plane and a box, a polygon (n, 3)."""
    sides = np.linalg.svd(normal[None])[2][1:]
    middle = (low + high) / 2
    middle = middle - ((middle - point) @ normal) * normal
    reach = float(np.linalg.norm(high - low))
    polygon = middle + reach * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) @ sides
    for axis, (corner, sign) in product(range(3), ((low, -1.0), (high, 1.0))):
        if len(polygon):
            polygon = cut(polygon, corner, sign * np.eye(3)[axis])
    return np.asarray(polygon)


def ball(centre: Array, radius: float, parts: int = 16) -> list[Array]:
    """Returns the faces (4, 3) of a sphere."""
    polar, turn = np.meshgrid(np.linspace(0, np.pi, parts // 2 + 1), np.linspace(0, 2 * np.pi, parts + 1))
    points = np.stack([np.sin(polar) * np.cos(turn), np.sin(polar) * np.sin(turn), np.cos(polar)], axis=-1)
    shell = centre + radius * points
    return [
        np.array([shell[i, j], shell[i + 1, j], shell[i + 1, j + 1], shell[i, j + 1]])
        for i in range(parts)
        for j in range(parts // 2)
    ]
