"""Animations of an arm that moves from one set of actuator states to the next."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from pathlib import Path
from typing import Any, NamedTuple, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hyperbit.controller.manipulator.manipulator import Manipulator
from hyperbit.controller.obstacles.obstacles import NONE, Obstacles
from hyperbit.controller.pictures.plots import COLOURS, Subplot, bounds, figure
from hyperbit.controller.workspace.densities import Densities

Array = NDArray[np.float64]

SHARES = (0.25, 0.5, 0.75, 1.0)  # displacements at which a transition is drawn
FRAME, END, PAUSE = 50, 110, 1300  # [ms], duration of a frame: in mid-travel, at the end of a transition, at a pause
SHADES = 48  # of the palette: fewer make a smaller file
SIDES, DOTS = (7.0, 5.9), 72.0  # of the picture [inch], and per inch


class Movement(NamedTuple):
    """The movement to show."""

    states: Sequence[ArrayLike]  # of the actuators, 0 or 1, shape (A,) each, one after the other; at least one
    pauses: Collection[int] = ()  # indices of the states at which the animation pauses


def animate(
    path: Path,
    manipulator: Manipulator,
    densities: Densities,
    movement: Movement,
    subplot: Subplot,
    obstacles: Obstacles = NONE,
) -> None:
    """Writes an endless animation, in the format of the path's suffix: .gif, .png (APNG) or .webp.

    A spatial arm needs no densities. Raises OSError, or ValueError for a suffix that Pillow does not know.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from PIL import Image

    steps = [np.asarray(each, dtype=float) for each in movement.states]
    bodies = [body_of(manipulator, step) for step in steps]
    shown = figure(manipulator, densities, [subplot], obstacles=obstacles)
    shown.set_size_inches(*SIDES)
    shown.set_dpi(DOTS)
    axes, canvas = shown.axes[0], cast(Any, FigureCanvasAgg)(shown)
    widen(axes, bodies, 2 if manipulator.planar else 3)
    lines, tips = moving(axes, manipulator)
    canvas.draw()
    shown.set_layout_engine("none")  # no new layout for each frame: it would take most of the time
    images, durations, trail = [], list[int](), list[Array]()
    for k, step in enumerate(steps):
        for share in SHARES if k else (1.0,):
            before = steps[max(k - 1, 0)]
            body = body_of(manipulator, before + share * (step - before))
            if np.isfinite(body).all():  # the arm's place is unknown otherwise
                lines.set_segments(body if not manipulator.planar else body[:, :, :2])
            if share == 1.0:
                trail.append(tip_of(manipulator, step))
                coordinates = np.array(trail).T
                tips.set_data(*coordinates[:2])
                if not manipulator.planar:
                    tips.set_3d_properties(coordinates[2])
            canvas.draw()
            images.append(Image.fromarray(np.asarray(canvas.buffer_rgba())).convert("RGB"))
            durations.append(FRAME if share < 1.0 else PAUSE if k in movement.pauses else END)
    swatch = images[-1].copy()  # thin lines and dots alone would have no colour of their own in the palette
    for k, colour in enumerate(COLOURS[:2]):
        swatch.paste(colour, (0, 40 * k, swatch.width, 40 * (k + 1)))
    palette = swatch.quantize(SHADES)
    few = [image.quantize(palette=palette, dither=Image.Dither.NONE) for image in images]
    few[0].save(path, save_all=True, append_images=few[1:], duration=durations, loop=0, optimize=True)


def body_of(manipulator: Manipulator, displacements: Array) -> Array:
    """Returns the line segments (n, 2, 3) of the arm in the world at displacements (A,); NaN if unknown."""
    return chained(manipulator, displacements)[0]


def tip_of(manipulator: Manipulator, displacements: Array) -> Array:
    """Returns the position of the tip in the world, shape (3,)."""
    return chained(manipulator, displacements)[1][:3, 3]


def chained(manipulator: Manipulator, displacements: Array) -> tuple[Array, Array]:
    """Returns the line segments (n, 2, 3) and the tip frame (4, 4) at displacements (A,), each from 0 to 1."""
    frame, parts, start = manipulator.base, list[Array](), 0
    for module in manipulator.modules:
        own = displacements[start : start + len(module.actuators)]
        start += len(module.actuators)
        step, body = module.between(own[None])
        parts.append(body[0] @ frame[:3, :3].T + frame[:3, 3])
        frame = np.asarray(frame @ step[0])
    return np.concatenate(parts), frame


def widen(axes: Any, bodies: list[Array], dimension: int) -> None:
    """Sets the bounds of axes so that all bodies are inside."""
    limits = [axes.get_xlim(), axes.get_ylim(), axes.get_zlim() if dimension == 3 else (0.0, 0.0)]
    corners = np.array(limits)[:dimension].T
    low, high = bounds([corners, *(body[:, :, :dimension].reshape(-1, dimension) for body in bodies)])
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]))
    if dimension == 3:
        axes.set(zlim=(low[2], high[2]))
        axes.set_box_aspect(high - low, zoom=0.9)


def moving(axes: Any, manipulator: Manipulator) -> tuple[Any, Any]:
    """Adds the moving parts to axes: the arm's lines and the path of the tip."""
    from matplotlib.collections import LineCollection
    from mpl_toolkits.mplot3d.art3d import Line3DCollection  # type: ignore[import-untyped]

    style: dict[str, Any] = {"colors": COLOURS[0], "linewidths": 2.0, "capstyle": "round", "zorder": 3}
    marks: dict[str, Any] = {"color": COLOURS[1], "marker": ".", "ms": 6, "linestyle": "none", "zorder": 6}
    if manipulator.planar:
        lines: Any = LineCollection([], **style)
        axes.add_collection(lines)
        return lines, axes.plot([], [], **marks)[0]
    lines = Line3DCollection(manipulator.body(np.zeros(len(manipulator.modules), dtype=int)), **style)
    axes.add_collection3d(lines)
    return lines, axes.plot([], [], [], **marks)[0]
