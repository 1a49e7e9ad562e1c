"""Animations of an arm that moves from one set of actuator states to the next."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO, NamedTuple, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hyperbit.controller.manipulator.manipulator import Manipulator
from hyperbit.controller.pictures.plots import COLOURS

if TYPE_CHECKING:  # matplotlib takes half a second to import
    from matplotlib.figure import Figure

Array = NDArray[np.float64]

SHARES = (0.25, 0.5, 0.75, 1.0)  # displacements at which a transition is drawn
FRAME, END, PAUSE = 50, 110, 1300  # [ms], duration of a frame: in mid-travel, at the end of a transition, at a pause
SHADES = 48  # of the palette: fewer make a smaller file
SIDES, DOTS = (7.0, 5.9), 72.0  # of the picture [inch], and per inch


class Movement(NamedTuple):
    """The movement to show."""

    states: Sequence[ArrayLike]  # of the actuators, 0 or 1, shape (A,) each, one after the other; at least one
    pauses: Collection[int] = ()  # indices of the states at which the animation pauses


class Film:
    """The frames of a movement, drawn into axes of a figure that has the rest of the picture.

    Attributes:
        figure: of the axes.
        durations: of each frame [ms].
    """

    def __init__(self, axes: Any, manipulator: Manipulator, movement: Movement) -> None:
        """Computes where the arm is in each frame."""
        self.figure: Figure = axes.get_figure(root=True)
        self.durations, self._bodies = list[int](), list[Array]()
        steps = [np.asarray(each, dtype=float) for each in movement.states]
        for k, step in enumerate(steps):
            before = steps[max(k - 1, 0)]
            for share in SHARES if k else (1.0,):
                body = body_of(manipulator, before + share * (step - before))
                known = np.isfinite(body).all()
                self._bodies.append(body if known else self._bodies[-1])  # the arm's place is unknown otherwise
                self.durations.append(FRAME if share < 1.0 else PAUSE if k in movement.pauses else END)
        self._tips = np.array([tip_of(manipulator, step) for step in steps])
        self._planar = manipulator.planar
        self._lines, self._dots = moving(axes, manipulator)

    def draw(self, k: int) -> tuple[Any, Any]:
        """Moves the arm to frame k; returns what has changed."""
        tips = self._tips[: 1 + k // len(SHARES)].T
        self._lines.set_segments(self._bodies[k][:, :, :2] if self._planar else self._bodies[k])
        self._dots.set_data(*tips[:2])
        if not self._planar:
            self._dots.set_3d_properties(tips[2])
        return self._lines, self._dots

    def write(self, path: Path | BinaryIO, form: str | None = None) -> None:
        """Writes an endless animation in a form: "gif", "png" (APNG) or "webp"; None: that of the path's suffix.

        Raises OSError, or ValueError for a suffix that Pillow does not know.
        """
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from PIL import Image

        own = self.figure.canvas
        canvas, images = cast(Any, FigureCanvasAgg)(self.figure), []
        try:
            for k in range(len(self.durations)):
                self.draw(k)
                canvas.draw()
                images.append(Image.fromarray(np.asarray(canvas.buffer_rgba())).convert("RGB"))
        finally:
            self.figure.set_canvas(own)
        swatch = images[-1].copy()  # thin lines and dots alone would have no colour of their own in the palette
        for k, colour in enumerate(COLOURS[:2]):
            swatch.paste(colour, (0, 40 * k, swatch.width, 40 * (k + 1)))
        palette = swatch.quantize(SHADES)
        few = [image.quantize(palette=palette, dither=Image.Dither.NONE) for image in images]
        times: dict[str, Any] = {"duration": self.durations, "loop": 0}
        few[0].save(path, form, save_all=True, append_images=few[1:], optimize=True, **times)


def film(shown: Figure, manipulator: Manipulator, movement: Movement) -> Film:
    """Returns the film of a movement in a figure, which is for this film alone."""
    shown.set_size_inches(*SIDES)
    shown.set_dpi(DOTS)
    result = Film(shown.axes[0], manipulator, movement)
    shown.draw_without_rendering()
    shown.set_layout_engine("none")  # no new layout for each frame: it would take most of the time
    return result


def body_of(manipulator: Manipulator, displacements: Array) -> Array:
    """Returns the line segments (n, 2, 3) of the arm in the world at displacements (A,); NaN if unknown."""
    return chained(manipulator, displacements)[0]


def ends(manipulator: Manipulator, states: Sequence[ArrayLike]) -> Array:
    """Returns the ends (n, 3) of the arm's lines in some states of the actuators, to have them inside the axes."""
    bodies = [body_of(manipulator, np.asarray(each, dtype=float)) for each in states]
    return np.concatenate([body.reshape(-1, 3) for body in bodies if np.isfinite(body).all()])


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
