"""Cost-to-go maps of a planar arm: the least cost with which the modules above a level bring the tip to a point.

The maps are a min-plus Mapping Algorithm: the recursion of the workspaces (section 3.1.1), with minimum and sum in
place of sum and product. A configuration of module i maps frame F_i to frame F_{i-1}. The map of level i - 1 is the
minimum over all states of the state's cost plus the map of level i. All rounding is downwards, so the value of a pixel
is a lower bound for all its points.
"""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numba import float64, int16, int64, types
from numpy.typing import NDArray

from hyperbit.controller.host.kernel import kernel
from hyperbit.controller.manipulator.kernel_types import F1, F2, I1, I2, named
from hyperbit.controller.manipulator.manipulator import Manipulator

Array = NDArray[np.float64]
Integers = NDArray[np.int64]
Levels = NDArray[np.int16]
Boxes = NDArray[np.float64]

UNREACHABLE = 9999  # level of pixels without a tip
STEPS = 8  # levels of the least cost of a switch: exact for equal weights, nearly exact for others
LENGTHS = 200.0  # pixels along the arm's length, at the base
HALFWAY = 2.0  # factor by which pixels are finer in the middle of the arm; they are finest at the tip
PREFIXES = 512.0  # configurations of the first modules, which have no maps: these would be large and prune little
MOST_LOOKUPS = 3.2e6  # look-ups of all levels; pixels grow until they are fewer
BORDER = 2  # pixels of the border around all tips
FRACTION = 16  # fractional bits of a pixel's coordinate
# A pixel, moved to the next level, must lie within a window of 3 x 3 pixels: half its diagonal is at most one pixel
# there, less 0.0128 of a pixel for rounding, see MOST_SIDE.
RATIO = 0.7163
MOST_SIDE = 800  # most pixels along a side; each adds at most 2 ** -FRACTION to the rounding error of a coordinate


class Maps(NamedTuple):
    """Cost-to-go maps of levels `first` to B."""

    first: int  # lowest level with a map
    unit: float  # cost of one level of `values`
    radius: float  # greatest distance of the tip from a point
    # cost of each pixel in units, level by level, x slowest; at least UNREACHABLE for pixels without a tip
    values: Levels
    offsets: Integers  # first pixel of each level in `values`, shape (B + 1,)
    shapes: Integers  # number of pixels along x and y, shape (B + 1, 2)
    corners: Array  # least corner of each level's box, shape (B + 1, 2)
    pixels: Array  # side of the pixels of each level, shape (B + 1,)


MAPS = named(Maps, int64, float64, float64, int16[::1], I1, I2, F2, F1)


class CostToGo:
    """Computes the cost-to-go maps of one planar arm; owns their memory.

    Boxes (B + 1, 4) are the least and greatest x and y of all tips in frames F_0 to F_B, see Hull.
    """

    def __init__(self, manipulator: Manipulator, boxes: Boxes) -> None:
        self._m, self._boxes = manipulator, boxes
        extents = np.linalg.norm(manipulator.translations, axis=2).max(axis=1)
        self._extents = np.append(np.cumsum(extents[::-1])[::-1], 0.0)
        products = np.cumprod(manipulator.states.astype(float))
        self._first = min(int(np.searchsorted(products, PREFIXES, side="right")), len(products))
        self._key: tuple[Array, float] | None = None
        self._maps: Maps | None = None
        self._window = np.empty(0, dtype=np.int16)

    def maps(self, costs: Array, radius: float) -> Maps:
        """Returns the maps for costs (B, Kmax) of the states and a radius. Earlier maps become invalid."""
        for _ in self.steps(costs, radius):
            pass
        assert self._maps is not None
        return self._maps

    def ready(self, costs: Array, radius: float) -> bool:
        return self._key is not None and self._key[1] == radius and np.array_equal(self._key[0], costs)

    def steps(self, costs: Array, radius: float) -> Iterator[None]:
        """Computes the maps level by level; returns at once if they are ready."""
        if self.ready(costs, radius):
            return
        self._key = None  # until it is done
        m, count = self._m, len(self._m.states)
        unit, levels = in_levels(costs)
        if self._maps is None or self._maps.radius != radius:
            self._maps = self._layout(radius)
        self._maps = maps = self._maps._replace(unit=unit)
        for level in range(count, maps.first - 1, -1):
            map_level(maps, level, m.rotations, m.translations, m.states, levels, self._window)
            yield
        self._key = (costs.copy(), radius)

    def _layout(self, radius: float) -> Maps:
        """Returns maps with memory for the values."""
        count, boxes = len(self._m.states), self._boxes
        scale, length = 1.0, max(float(self._extents[0]), radius)
        widths = np.stack((boxes[:, 1] - boxes[:, 0], boxes[:, 3] - boxes[:, 2]), axis=1) + 2 * radius
        while True:
            base = scale * length / LENGTHS
            pixels = np.minimum(base, base / HALFWAY * (2 * self._extents / length) ** 1.5)
            pixels = np.maximum(pixels, np.maximum(radius, widths.max(axis=1) / (MOST_SIDE - 2 * BORDER - 2)))
            for level in range(1, count + 1):
                pixels[level] = max(pixels[level], pixels[level - 1] * RATIO)
            shapes = (widths / pixels[:, None]).astype(np.int64) + 2 * BORDER + 1
            sizes = shapes.prod(axis=1)
            sizes[: self._first] = 0
            if (sizes[:-1] * self._m.states).sum() <= MOST_LOOKUPS or shapes.max() <= 2 * BORDER + 2:
                break
            scale *= 1.2
        offsets = np.concatenate([[0], np.cumsum(sizes)[:-1]])
        values = np.empty(int(sizes.sum()), dtype=np.int16)
        self._window = np.empty(int(sizes.max()), dtype=np.int16)
        corners = boxes[:, (0, 2)] - radius - BORDER * pixels[:, None]
        return Maps(self._first, 1.0, radius, values, offsets, shapes, np.ascontiguousarray(corners), pixels)


def in_levels(costs: Array) -> tuple[float, Levels]:
    """Returns the unit of cost, and costs (B, Kmax) in units, rounded downwards."""
    positive, dearest = costs[costs > 0], float(costs.max(axis=1).sum())
    unit = max(float(positive.min()) / STEPS, dearest / (UNREACHABLE - 1)) if len(positive) else 1.0
    return unit, (costs / unit + 1e-11).astype(np.int16)


@kernel("UniTuple(i8, 2)(f8, f8, i8, i8, i8)", error_model="numpy")
def inside(start: float, step: float, size: int, low: int, high: int) -> tuple[int, int]:
    """Returns the range of v = low..high-1 with 0 <= start + v * step < size << FRACTION."""
    top = float(size << FRACTION) - 1.0
    if step == 0.0:
        return (low, high) if 0.0 <= start <= top else (0, 0)
    one, other = -start / step, (top - start) / step
    if one > other:
        one, other = other, one
    return int(max(float(low), np.ceil(one + 1e-9))), int(min(float(high), np.floor(other - 1e-9) + 1.0))


@kernel(types.void(int16[::1], int64, int64, int16[::1]))
def write_window(values: Levels, nx: int, ny: int, window: Levels) -> None:
    """Writes the least value of each pixel and its eight neighbours; UNREACHABLE along the edge."""
    before, nothing = np.empty(ny, dtype=np.int16), np.int16(UNREACHABLE)
    for u in range(nx):
        row, own = window[u * ny : u * ny + ny], values[u * ny : u * ny + ny]
        for v in range(1, ny - 1):
            row[v] = min(min(own[v - 1], own[v]), own[v + 1])
        row[0] = row[ny - 1] = nothing
    for v in range(ny):
        before[v] = window[v]
    for u in range(nx - 1):
        row, after = window[u * ny : u * ny + ny], window[(u + 1) * ny : (u + 1) * ny + ny]
        for v in range(ny):
            own_value = row[v]
            row[v] = min(min(before[v], own_value), after[v])
            before[v] = own_value
    for v in range(ny):
        window[v] = window[(nx - 1) * ny + v] = nothing


@kernel(
    types.void(MAPS, int64, float64[:, :, :, ::1], float64[:, :, ::1], int64[::1], int16[:, ::1], int16[::1]),
    error_model="numpy",
)
def map_level(
    maps: Maps, level: int, rotations: Array, translations: Array, states: Integers, levels: Levels, window: Levels
) -> None:
    """Computes the map of one level from the window of the level above, and this level's window.

    Args:
        maps: written: the level's values.
        level: number of modules below.
        rotations: configuration sets, shape (B, Kmax, 3, 3).
        translations: configuration sets, shape (B, Kmax, 3).
        states: K_i, shape (B,).
        levels: costs of every module's states in levels, shape (B, Kmax).
        window: least value of each pixel of the level above and its eight neighbours; overwritten with this level's.
    """
    nx, ny, side = maps.shapes[level, 0], maps.shapes[level, 1], maps.pixels[level]
    values = maps.values[maps.offsets[level] : maps.offsets[level] + nx * ny]
    x0, y0, nothing = maps.corners[level, 0], maps.corners[level, 1], np.int16(UNREACHABLE)
    if level == len(states):
        for u in range(nx):
            for v in range(ny):
                x, y = x0 + u * side, y0 + v * side
                dx, dy = max(x, -(x + side), 0.0), max(y, -(y + side), 0.0)
                within = dx * dx + dy * dy <= maps.radius * maps.radius * (1 + 1e-9)
                values[u * ny + v] = np.int16(0) if within else nothing
    else:
        values[:] = nothing
        mx, my = maps.shapes[level + 1, 0], maps.shapes[level + 1, 1]
        stride, per = np.int32(my), float(1 << FRACTION) / maps.pixels[level + 1]
        for u in range(nx):
            row = values[u * ny : u * ny + ny]
            for j in range(states[level]):
                c, s, price = rotations[level, j, 0, 0], rotations[level, j, 1, 0], levels[level, j]
                dx = x0 + (u + 0.5) * side - translations[level, j, 0]
                dy = y0 + 0.5 * side - translations[level, j, 1]
                px = int((c * dx + s * dy - maps.corners[level + 1, 0]) * per)
                py = int((c * dy - s * dx - maps.corners[level + 1, 1]) * per)
                ax, ay = int(s * side * per), int(c * side * per)
                low, high = inside(float(px), float(ax), mx, 0, ny)
                low, high = inside(float(py), float(ay), my, low, high)
                qx, qy = np.int32(px + low * ax), np.int32(py + low * ay)
                for v in range(low, high):
                    value = np.int16(window[(qx >> FRACTION) * stride + (qy >> FRACTION)] + price)
                    row[v] = min(row[v], value)
                    qx += np.int32(ax)
                    qy += np.int32(ay)
    if level > maps.first:
        write_window(values, nx, ny, window)
