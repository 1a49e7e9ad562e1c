"""Pictures of an arm's workspace: densities of positions and orientations, and the reach with locked actuators."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hyperbit.controller.armfile.units import unit_mark, unit_name
from hyperbit.controller.manipulator.manipulator import Manipulator
from hyperbit.controller.obstacles.obstacles import Obstacles
from hyperbit.controller.pictures.orientation_plots import ORANGE, draw_angles, draw_rotations
from hyperbit.controller.pictures.plots import DARKEST, LIGHTEST, draw_obstacles
from hyperbit.controller.workspace.densities import Densities, ball
from hyperbit.controller.workspace.locked_reach import LockedReach
from hyperbit.controller.workspace.orientations import Orientations

if TYPE_CHECKING:  # matplotlib takes half a second to import
    from matplotlib.figure import Figure

Array = NDArray[np.float64]

BLUE = "#0072B2"
SLICES = ((2, 0, 1), (1, 0, 2), (0, 1, 2))  # axis that a slice cuts, and the axes that it shows


class Field(NamedTuple):
    """Numbers of configurations within the tolerance of goals, in pixels parallel to the axes of the base."""

    title: str
    counts: Array  # log10 of the numbers, minus infinity for none, shape (z, y, x)
    reference: Array  # centre of the first pixel in the base frame, x, y, z
    pixel: float  # side of the pixels
    lost: NDArray[np.bool_] | None = None  # pixels to mark, shape (z, y, x)


class Slice(NamedTuple):
    counts: Array  # log10 of the numbers, minus infinity for none, shape (rows, columns)
    lost: NDArray[np.bool_] | None  # pixels to mark, shape (rows, columns)
    reference: Array  # centre of the first pixel, horizontal and vertical
    pixel: float  # side of the pixels


def positions_field(densities: Densities, dimension: int, tolerance: float) -> Field:
    """Returns the density of the tip's positions as numbers of configurations within a tolerance."""
    values, pixel = densities.level(0).astype(float), float(densities.pixels[0])
    logs = np.where(values >= 0, values + math.log(ball(dimension, tolerance) / pixel**dimension), -np.inf)
    return Field("positions", logs / math.log(10), densities.references[0], pixel)


def locked_field(found: LockedReach, locks: int) -> Field:
    """Returns the least numbers of configurations over all choices of locked actuators."""
    some = "any one actuator" if locks == 1 else f"any of {len(found.choices)} choices of {locks} actuators"
    counts = found.least_counts / math.log(10)
    lost = np.isfinite(found.free_counts) & ~np.isfinite(found.least_counts)
    return Field(f"worst case, {some} locked", counts, found.reference, found.pixel, lost)


def draw_workspace(
    manipulator: Manipulator,
    fields: list[Field],
    point: ArrayLike | None = None,
    orientations: Orientations | None = None,
    title: str = "",
    unit: str | None = None,
    among: tuple[Obstacles, Array] | None = None,
) -> Figure:
    """Returns the picture of a workspace: one row for a planar arm, a row of slices for each field of a spatial arm.

    `point` is a position in the world to mark, through which slices go; None: the densest pixel of the first field.
    `orientations` are those at the point, if they are to be drawn. `unit` is that of length; None: the file's.
    `among`: obstacles, and positions (n, 2) in the world that they take away, drawn for planar arms only.
    """
    from matplotlib.figure import Figure

    columns = len(fields) + (orientations is not None) if manipulator.planar else 3
    rows = 1 if manipulator.planar else len(fields) + (orientations is not None)
    result = Figure(figsize=(5.4 * columns, (5.2 if manipulator.planar else 4.2) * rows), layout="constrained")
    result.suptitle(title)
    parts = result.subfigures(rows, 1, squeeze=False)[:, 0]
    marked = None if point is None else in_base(manipulator, point)
    if manipulator.planar:
        for k, field in enumerate(fields):
            axes = parts[0].add_subplot(1, columns, k + 1)
            draw_plane(axes, manipulator, field, point, unit)
            if among is not None:
                draw_lost(axes, *among)
        add_key(parts[0], parts[0].axes, fields)
        if orientations is not None:
            draw_angles(parts[0].add_subplot(1, columns, columns, projection="polar"), orientations)
        return result
    centre = densest(fields[0]) if marked is None else marked
    for part, field in zip(parts, fields, strict=False):
        draw_slices(part, field, centre, unit, cross=marked is not None)
    if orientations is not None:
        draw_rotations(parts[-1], orientations)
    return result


def in_base(manipulator: Manipulator, point: ArrayLike) -> Array:
    """Returns a position of the world, (2,) or (3,), in the base frame, shape (3,)."""
    full = np.zeros(3)
    full[: manipulator.dimension] = point
    return np.asarray(manipulator.base[:3, :3].T @ (full - manipulator.base[:3, 3]))


def densest(field: Field) -> Array:
    z, y, x = np.unravel_index(int(field.counts.argmax()), field.counts.shape)
    return np.asarray(field.reference + field.pixel * np.array([x, y, z]))


def draw_plane(axes: Any, manipulator: Manipulator, field: Field, point: ArrayLike | None, unit: str | None) -> None:
    from matplotlib.transforms import Affine2D

    base = manipulator.base[np.ix_([0, 1, 3], [0, 1, 3])]
    transform = Affine2D(base) + axes.transData
    lost = None if field.lost is None else field.lost[0]
    extent = draw_counts(axes, Slice(field.counts[0], lost, field.reference[:2], field.pixel), transform)
    corners = np.array([[x, y] for x in extent[:2] for y in extent[2:]]) @ base[:2, :2].T + base[:2, 2]
    axes.plot(*base[:2, 2], "^", color=BLUE, markersize=8, label="base")
    if point is not None:
        axes.plot(*np.asarray(point)[:2], "x", color="black", markersize=9, markeredgewidth=2, label="point")
    low, high = corners.min(axis=0), corners.max(axis=0)
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal", title=field.title)
    axes.set(xlabel=f"x [{unit_name(unit)}]", ylabel=f"y [{unit_name(unit)}]")


def draw_lost(axes: Any, obstacles: Obstacles, positions: Array) -> None:
    """Draws obstacles, and positions (n, 2) in the world that they take away."""
    (left, right), (bottom, top) = axes.get_xlim(), axes.get_ylim()
    draw_obstacles(axes, obstacles, np.array([left, bottom]), np.array([right, top]))
    axes.plot(*positions.T, ".", color=ORANGE, markersize=4, label="lost to obstacles")


def draw_slices(figure: Any, field: Field, centre: Array, unit: str | None, *, cross: bool) -> None:
    """Draws the slices of a spatial arm's field through a point of the base frame."""
    figure.suptitle(field.title)
    index = np.clip(np.round((centre - field.reference) / field.pixel).astype(int), 0, field.counts.shape[::-1])
    index = np.minimum(index, np.array(field.counts.shape[::-1]) - 1)
    finite = field.counts[np.isfinite(field.counts)]
    limits = (float(finite.min()), float(finite.max())) if len(finite) else (0.0, 1.0)
    for k, (cut, across, up) in enumerate(SLICES):
        axes = figure.add_subplot(1, 3, k + 1)
        counts = np.take(field.counts, index[cut], axis=2 - cut)
        lost = None if field.lost is None else np.take(field.lost, index[cut], axis=2 - cut)
        part = Slice(counts, lost, field.reference[[across, up]], field.pixel)
        draw_counts(axes, part, axes.transData, limits)
        if cross:
            axes.plot(centre[across], centre[up], "x", color="black", markersize=9, markeredgewidth=2)
        names = "xyz"
        axes.set(
            xlabel=f"{names[across]} of the base [{unit_name(unit)}]",
            ylabel=f"{names[up]} of the base [{unit_name(unit)}]",
        )
        axes.set(aspect="equal", title=f"{names[cut]} = {centre[cut]:.3g}{unit_mark(unit)}")
    add_key(figure, figure.axes, [field])


def draw_counts(
    axes: Any, part: Slice, transform: Any, limits: tuple[float, float] | None = None
) -> tuple[float, float, float, float]:
    """Draws the numbers of configurations in gray, and lost pixels in colour; returns left, right, bottom and top.

    `transform` leads from the field's frame to the axes. `limits` are log10 of the numbers drawn in the lightest and
    the darkest gray; None: the least and the greatest.
    """
    from matplotlib.colors import LinearSegmentedColormap, ListedColormap

    counts, lost, reference, pixel = part
    rows, columns = counts.shape
    left, bottom = reference - pixel / 2
    extent = (float(left), float(left + columns * pixel), float(bottom), float(bottom + rows * pixel))
    options: dict[str, Any] = {"extent": extent, "origin": "lower", "interpolation": "nearest", "transform": transform}
    shown = np.where(np.isfinite(counts), counts, np.nan)
    if limits is None:
        limits = (float(np.nanmin(shown)), float(np.nanmax(shown))) if np.isfinite(counts).any() else (0.0, 1.0)
    gray = LinearSegmentedColormap.from_list("counts", [str(LIGHTEST), str(DARKEST / 3)])
    shades = axes.imshow(shown, cmap=gray, vmin=limits[0], vmax=limits[1], **options)
    bar = axes.figure.colorbar(shades, ax=axes, shrink=0.7, pad=0.02)
    bar.set_label("configurations within the tolerance", fontsize="small")
    bar.ax.yaxis.set_major_formatter(lambda power, _: f"$10^{{{power:g}}}$")
    if lost is not None and lost.any():
        axes.imshow(np.where(lost, 1.0, np.nan), cmap=ListedColormap([ORANGE]), vmin=0, vmax=1, **options)
    draw_limit(axes, part, transform)
    return extent


def draw_limit(axes: Any, part: Slice, transform: Any) -> None:
    """Draws the line inside which most pixels have at least one configuration."""
    from scipy.ndimage import uniform_filter

    rows, columns = (2 + size for size in part.counts.shape)  # one empty pixel all round closes the line
    width = min(max(rows, columns) // 40 | 1, 15)
    inside = uniform_filter(np.pad(part.counts >= 0, 1).astype(float), max(width, 3), mode="constant")
    if inside.max() <= 0.5:
        return
    x, y = (start + part.pixel * np.arange(-1, n - 1) for start, n in zip(part.reference, (columns, rows), strict=True))
    axes.contour(x, y, inside, levels=[0.5], colors=BLUE, linewidths=1.0, transform=transform)
    axes.plot([], [], color=BLUE, linewidth=1.0, label="one configuration")


def add_key(figure: Any, every: list[Any], fields: list[Field]) -> None:
    from matplotlib.patches import Patch

    handles: dict[str, Any] = {}
    for axes in every:
        handles |= {label: handle for handle, label in zip(*axes.get_legend_handles_labels(), strict=True)}
    if any(field.lost is not None and field.lost.any() for field in fields):
        handles["lost with some choice"] = Patch(color=ORANGE)
    if handles:
        figure.legend(
            handles.values(), handles.keys(), loc="outside lower center", ncols=min(len(handles), 3), frameon=False
        )
