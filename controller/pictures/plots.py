"""Pictures of arms over the point density of their workspace, in the style of the paper's Figure 5."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import cycle, pairwise, product
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hyperbit.controller.armfile.units import unit_name
from hyperbit.controller.manipulator.manipulator import Configuration, Manipulator
from hyperbit.controller.obstacles.distance import BOX, SPHERE
from hyperbit.controller.obstacles.obstacles import NONE, Obstacles
from hyperbit.controller.workspace.densities import Densities

if TYPE_CHECKING:  # matplotlib takes half a second to import
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Array = NDArray[np.float64]

# Okabe and Ito's colours for colour-blind readers, without those that vanish on gray.
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")
LIGHTEST, DARKEST = 0.88, 0.55
# Densities within this factor of the greatest are all drawn in the darkest gray.
SATURATED = 1000.0
SLIMMEST = 0.4
LABELS = 36  # [points] between plane axes and the legend below them, for the numbers and the name of the x axis
OBSTACLE = "#8C2D04"
KEEP_OUT = "keep out"  # name of all obstacles in the legend
FACES = ((0, 1, 3, 2), (4, 5, 7, 6), (0, 1, 5, 4), (2, 3, 7, 6), (0, 2, 6, 4), (1, 3, 7, 5))  # of CORNERS
CORNERS = np.array(list(product((-1.0, 1.0), repeat=3)))
CROWDED = 60  # lines of one spatial arm, drawn thinner from there on


@dataclass(frozen=True, eq=False)
class Subplot:
    """The content of one picture."""

    title: str = ""
    configurations: Mapping[str, Configuration] = field(default_factory=dict)  # by their names in the legend
    targets: ArrayLike = ()  # drawn as black crosses, shape (n, 2) or (n, 3)
    curve: ArrayLike = ()  # waypoints, drawn as a dotted line, shape (n, 2) or (n, 3)
    around: ArrayLike = ()  # further points inside the axes, shape (n, 3)


def save(
    path: Path,
    manipulator: Manipulator,
    densities: Densities | None,
    subplots: Sequence[Subplot],
    unit: str | None = None,
    obstacles: Obstacles = NONE,
) -> None:
    """Writes a picture of the subplots side by side, in the format of the path's suffix.

    A planar arm is drawn without densities if they are None, a spatial arm always. `unit` is that of length, for the
    axes; None: that of the arm's file. Raises OSError, or ValueError for a suffix that matplotlib does not know.
    """
    figure(manipulator, densities, subplots, unit, obstacles).savefig(path, dpi=150, bbox_inches="tight")


def figure(
    manipulator: Manipulator,
    densities: Densities | None,
    subplots: Sequence[Subplot],
    unit: str | None = None,
    obstacles: Obstacles = NONE,
) -> Figure:
    """Returns the picture that `save` writes; without densities if they are None."""
    from hyperbit.controller.pictures.picture import Picture

    result = Picture(figsize=(6.0 * len(subplots) + 0.6, 6.2), layout="constrained")
    shades = None
    for k, subplot in enumerate(subplots):
        if manipulator.planar:
            axes = result.add_subplot(1, len(subplots), k + 1)
            shades = draw(axes, manipulator, densities, subplot, unit, obstacles)
        else:
            axes = result.add_subplot(1, len(subplots), k + 1, projection="3d")
            draw_spatial(axes, manipulator, subplot, unit, obstacles)
    if shades is not None:
        bar = result.colorbar(shades, ax=result.axes, extend="max", shrink=0.7, aspect=30, pad=0.02)
        bar.set_label(f"point density [1/({unit_name(unit)})²]" if unit is None else f"point density [1/{unit}²]")
        bar.ax.yaxis.set_major_formatter(lambda power, _: f"$10^{{{power:g}}}$")
    return result


def draw(
    axes: Axes,
    manipulator: Manipulator,
    densities: Densities | None,
    subplot: Subplot,
    unit: str | None = None,
    obstacles: Obstacles = NONE,
) -> Any:
    """Draws a planar arm in the world over the density of W_0; returns the image of the density, or None."""
    from matplotlib.collections import LineCollection

    shades, everything = None, [manipulator.base[None, :2, 3], points(subplot.around, 3)[:, :2]]
    if densities is not None:
        shades, reachable = draw_density(axes, manipulator, densities)
        everything.append(reachable)
    for name, configuration, colour, width in styled(subplot):
        body = manipulator.body(configuration)[:, :, :2]
        for line, shade, order in ((width + 1.6, "white", 2), (width, colour, 3)):  # the rims below all colours
            lines = LineCollection(list(body), colors=shade, linewidths=line, capstyle="round", zorder=order)
            axes.add_collection(lines)
        axes.plot([], [], color=colour, linewidth=2, label=name)
        everything.append(body.reshape(-1, 2))
    goals = draw_goals(axes, subplot, 2)
    low, high = bounds([*everything, *goals])
    if densities is None:
        low, high = widened(low, high)
    draw_obstacles(axes, obstacles, low, high)
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal", title=subplot.title)
    axes.set(xlabel=f"x [{unit_name(unit)}]", ylabel=f"y [{unit_name(unit)}]")
    add_legend(axes)
    return shades


def draw_density(axes: Axes, manipulator: Manipulator, densities: Densities) -> tuple[Any, NDArray[np.float64]]:
    """Draws W_0 in logarithmic gray; returns the image and the pixels (n, 2) in the world that have points."""
    from matplotlib.colors import LinearSegmentedColormap
    from matplotlib.transforms import Affine2D

    values = densities.level(0)[0].astype(float)
    density = (values - np.log(densities.volume(0, planar=True))) / np.log(10.0)
    density[values < 0] = np.nan
    most = float(np.nanmax(density)) - np.log10(SATURATED)
    least = min(float(np.nanmin(density)), most - 1.0)
    (left, bottom, _), (right, top, _) = densities.box(0)
    base = manipulator.base[np.ix_([0, 1, 3], [0, 1, 3])]
    shades = axes.imshow(
        density,
        cmap=LinearSegmentedColormap.from_list("density", [str(LIGHTEST), str(DARKEST)]),
        vmin=least,
        vmax=most,
        extent=(left, right, bottom, top),
        origin="lower",
        interpolation="nearest",
        transform=Affine2D(base) + axes.transData,
        zorder=0,
    )
    y, x = np.nonzero(values >= 0)
    centres = densities.references[0] + densities.pixels[0] * np.column_stack((x, y, np.zeros(len(x))))
    return shades, centres[:, :2] @ base[:2, :2].T + base[:2, 2]


def draw_spatial(
    axes: Any, manipulator: Manipulator, subplot: Subplot, unit: str | None = None, obstacles: Obstacles = NONE
) -> None:
    """Draws a spatial arm in the world, on matplotlib's 3-D axes, without its density."""
    from matplotlib.ticker import MaxNLocator, MultipleLocator
    from mpl_toolkits.mplot3d.art3d import Line3DCollection  # type: ignore[import-untyped]

    axes.computed_zorder = False  # else an arm in front hides waypoints and targets
    everything = [manipulator.base[None, :3, 3], points(subplot.around, 3)]
    for name, configuration, colour, width in styled(subplot):
        body = manipulator.body(configuration)
        width *= 1.0 if len(body) < CROWDED else 0.6
        lines = Line3DCollection(body, colors=colour, linewidths=width, label=name, capstyle="round", zorder=3)
        axes.add_collection3d(lines)
        everything.append(body.reshape(-1, 3))
    goals = draw_goals(axes, subplot, 3)
    low, high = bounds([*everything, *goals])
    draw_spatial_obstacles(axes, obstacles, low, high)
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), zlim=(low[2], high[2]), title=subplot.title)
    ticks = MaxNLocator(5).tick_values(0.0, (high - low).max())
    for axis, name in ((axes.xaxis, "x"), (axes.yaxis, "y"), (axes.zaxis, "z")):
        axis.set_major_locator(MultipleLocator(ticks[1] - ticks[0]))
        axis.set_label_text(f"{name} [{unit_name(unit)}]")
        axis.labelpad = 10
    axes.set_box_aspect(high - low, zoom=0.9)  # smaller, so that the labels stay in the picture
    add_legend(axes)


def draw_goals(axes: Any, subplot: Subplot, dimension: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Draws waypoints, dotted, and targets, crossed; returns the points of both, shape (n, dimension) each."""
    from matplotlib.patheffects import withStroke

    curve, targets = points(subplot.curve, dimension), points(subplot.targets, dimension)
    if len(curve):
        halo = [withStroke(linewidth=3.2, foreground="white")]
        axes.plot(*curve.T, ":", color="black", linewidth=1.6, label="waypoints", path_effects=halo, zorder=4)
    if len(targets):
        bold = [withStroke(linewidth=4.5, foreground="white")]
        axes.plot(*targets.T, "x", color="black", ms=9, mew=2, label="targets", path_effects=bold, zorder=5)
    return curve, targets


def add_legend(axes: Any) -> None:
    from matplotlib.transforms import ScaledTranslation

    count = len(axes.get_legend_handles_labels()[1])
    if not count:
        return
    below: dict[str, Any] = {"bbox_to_anchor": (0.5, -0.1)}
    if axes.name != "3d":  # an absolute length: a flat picture has labels below its axes, too
        down = ScaledTranslation(0.0, -LABELS / 72, axes.figure.dpi_scale_trans)
        below = {"bbox_to_anchor": (0.5, 0.0), "bbox_transform": axes.transAxes + down}
    axes.legend(loc="upper center", ncols=count if count <= 4 else 3, frameon=False, **below)


def styled(subplot: Subplot) -> Iterator[tuple[str, Configuration, str, float]]:
    """Yields name, configuration, colour and line width; widths decrease, so that coinciding modules stay visible."""
    last = len(subplot.configurations) - 1
    for k, ((name, configuration), colour) in enumerate(
        zip(subplot.configurations.items(), cycle(COLOURS), strict=False)
    ):
        yield name, configuration, colour, 1.3 + min(last - k, 3)


def points(given: ArrayLike, dimension: int) -> NDArray[np.float64]:
    return np.asarray(given, dtype=float).reshape(-1, dimension)


def bounds(parts: list[NDArray[np.float64]]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Returns the lower and upper corner of a box around all points, with a margin and sides above 0."""
    everything = np.concatenate(parts)
    low, high = everything.min(axis=0), everything.max(axis=0)
    margin = 0.04 * (high - low).max() or 1.0
    return low - margin, high + margin


def widened(low: NDArray[np.float64], high: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Returns corners of a box that is nowhere slimmer than SLIMMEST times its longest side."""
    middle, sides = (low + high) / 2, high - low
    half = np.maximum(sides, SLIMMEST * sides.max()) / 2
    return middle - half, middle + half


def draw_obstacles(axes: Axes, obstacles: Obstacles, low: Array, high: Array) -> None:
    """Draws planar obstacles as hatched patches; half-planes end at the corners (2,) of the axes."""
    from matplotlib.patches import Circle, Patch, Polygon

    style: dict[str, Any] = {"facecolor": OBSTACLE + "30", "edgecolor": OBSTACLE, "hatch": "///", "linewidth": 1.0}
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
        patch.set(**style, label="" if axes.get_legend_handles_labels()[1][-1:] == [KEEP_OUT] else KEEP_OUT, zorder=1)
        axes.add_patch(patch)


def draw_spatial_obstacles(axes: Any, obstacles: Obstacles, low: Array, high: Array) -> None:
    """Draws spatial obstacles as translucent bodies; half-spaces as planes within the corners (3,) of the axes."""
    from mpl_toolkits.mplot3d.art3d import Poly3DCollection

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
        label = "" if axes.get_legend_handles_labels()[1][-1:] == [KEEP_OUT] else KEEP_OUT
        if faces:
            shape = Poly3DCollection(
                faces, facecolors=OBSTACLE + "30", edgecolors=OBSTACLE + "60", linewidths=0.4, zorder=1
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
