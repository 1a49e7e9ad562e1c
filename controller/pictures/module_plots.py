"""Drawings of the module types with their letters and numbers, and of the notation of a configuration.

All lines come from the modules that hyperbit computes with.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from hyperbit.controller.armfile.fields import Diagonal
from hyperbit.controller.manipulator import frames
from hyperbit.controller.manipulator.joints import prismatic, revolute
from hyperbit.controller.manipulator.manipulator import Manipulator
from hyperbit.controller.manipulator.module import Module, tipped, transforms
from hyperbit.controller.manipulator.notation import format_configuration
from hyperbit.controller.manipulator.platform import platform
from hyperbit.controller.manipulator.vgt import vgt

if TYPE_CHECKING:  # matplotlib takes half a second to import: only those who draw wait for it
    from matplotlib.axes import Axes

DARK, BLUE, ORANGE, LIGHT = "#16191D", "#0072B2", "#D55E00", "#B8C0C8"
LENGTHS = (0.2, 0.25)  # contracted and extended
PLANAR = [[-0.1, 0.0], [0.0, 0.0], [0.1, 0.0]], [[-0.1, 0.0], [0.1, 0.0], [0.1, 0.0]]  # joints below and above
SPATIAL = tuple(
    [[0.13 * np.cos(angle), 0.13 * np.sin(angle), 0.0] for angle in np.radians(degrees)]
    for degrees in ((350, 10, 110, 130, 230, 250), (310, 50, 70, 170, 190, 290))
)
Array = NDArray[np.float64]


def save_types(path: Path) -> None:
    """Writes a drawing of each module type, in the format of the path's suffix.

    Raises:
        OSError: the file cannot be written.
        ValueError: matplotlib knows no such suffix.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(14, 7.4), layout="constrained")
    axes = figure.subplots(2, 4).ravel()
    trusses: tuple[tuple[Diagonal, str], ...] = (("BC", "vgt, diagonal BC"), ("AD", "vgt, diagonal AD: the next one"))
    for own, (diagonal, title) in zip(axes, trusses, strict=False):
        draw_truss(own, vgt(diagonal, 0.2, LENGTHS, LENGTHS, LENGTHS, base_bar=True), diagonal, title)
    draw_joint(axes[2], revolute((0, 0, 1), (-0.4, 0.0, 0.4), frames.planar(0, 0.25)), "revolute: angles -0.4, 0, 0.4")
    draw_joint(
        axes[3], prismatic((0, 1, 0), (0.0, 0.08, 0.16), frames.planar(0, 0.1)), "prismatic: lengths 0, 0.08, 0.16"
    )
    draw_platform(axes[4], PLANAR, "platform: three legs in the plane")
    draw_platform(axes[5], SPATIAL, "platform: six legs in space")
    states = [frames.planar(0, 0.2), frames.planar(0.08, 0.22, -0.5), frames.planar(-0.1, 0.25, 0.4)]
    draw_joint(axes[6], transforms(states, planar=True), "transforms: any frames")
    draw_tool(axes[7])
    figure.savefig(path, dpi=100)


def save_notation(path: Path) -> None:
    """Writes a drawing of a truss arm in a configuration, with the meaning of each digit; see save_types."""
    from matplotlib.figure import Figure

    pair = [vgt(diagonal, 0.2, LENGTHS, LENGTHS, LENGTHS) for diagonal in ("BC", "AD")]
    arm = Manipulator([vgt("BC", 0.2, LENGTHS, LENGTHS, LENGTHS, base_bar=True), pair[1], *pair])
    configuration = np.array([4, 6, 1, 7])
    figure = Figure(figsize=(9, 5), layout="constrained")
    axes = figure.subplots(1, 1)
    bare(axes, f'configuration "{format_configuration(arm, configuration)}": one digit for each module, base first')
    chain, first = arm.chain(configuration), 0
    beside = float(arm.body(configuration)[:, :, 0].max()) + 0.06
    for i, (module, state) in enumerate(zip(arm.modules, configuration.tolist(), strict=True)):
        body = placed(module.body[state], chain[i])
        bits = module.bits[state].tolist()
        for segment, bit in zip(body, bits, strict=False):
            line(axes, segment, ORANGE if bit else BLUE, 4.0 if bit else 2.0)
        for segment in body[len(bits) :]:
            line(axes, segment, DARK, 1.4)
        y = float(chain[i][1, 3] + chain[i + 1][1, 3]) / 2
        words = ", ".join(
            f"{name} {'extended' if bit else 'contracted'}" for name, bit in zip(module.actuators, bits, strict=True)
        )
        digits = "".join(map(str, bits))
        axes.text(
            beside,
            y,
            f"module {i + 1}: digit {state} = {digits}",
            va="center",
            fontsize=11,
            fontweight="bold",
            color=DARK,
        )
        axes.text(beside, y - 0.055, words, va="center", fontsize=9, color=DARK)
        first += len(module.actuators)
    axes.text(-0.2, -0.09, "base", fontsize=9, color=DARK)
    axes.text(
        beside,
        -0.09,
        f"{first} actuators: thick orange = extended (1), thin blue = contracted (0)",
        fontsize=9,
        color=DARK,
    )
    axes.set_xlim(-0.25, beside + 0.8)
    figure.savefig(path, dpi=100)


def draw_truss(axes: Axes, module: Module, diagonal: str, title: str) -> None:
    """Draws a truss contracted, with its corners A to D and the names of its actuators; and extended, in light gray."""
    bare(axes, title)
    for segment in module.body[-1]:
        line(axes, segment, LIGHT, 1.2)
    body = module.body[0]
    for name, segment in zip(module.actuators, body, strict=False):
        line(axes, segment, BLUE, 3.0)
        label(axes, segment.mean(axis=0), name, BLUE, 10)
    for segment in body[3:]:
        line(axes, segment, DARK, 2.0)
    corners = {"A": body[0, 0], "C": body[0, 1], "B": body[2, 0], "D": body[2, 1]}
    for letter, place in corners.items():
        below = letter in "AB"
        x, y, side = float(place[0]), float(place[1]) + (-0.022 if below else 0.014), "top" if below else "bottom"
        axes.text(x, y, letter, ha="center", va=side, fontsize=12, fontweight="bold", color=DARK)
    draw_frame(axes, module.frames[0], "")
    x, y = module.frames[0][:2, 3].tolist()
    axes.text(x + 0.008, y + 0.02, "frame above", fontsize=8, color=ORANGE)
    axes.text(0, -0.05, f"width |AB| = |CD|; diagonal {diagonal}", ha="center", va="top", fontsize=9, color=DARK)


def draw_joint(axes: Axes, module: Module, title: str) -> None:
    """Draws all states of a module as lines to their frames, with number and actuator bits."""
    bare(axes, title)
    turns = bool(np.ptp(module.frames[:, 0, 3]) > 0)
    for k, (segment, bits) in enumerate(zip(module.body[:, 0], module.bits, strict=True)):
        line(axes, segment, BLUE if k == 0 else LIGHT, 3.0 if k == 0 else 1.6)
        spelled = "".join(map(str, bits.tolist()))
        draw_frame(axes, module.frames[k], f"state {k} = {spelled}", above=turns)
    axes.plot([0], [0], "o", color=DARK, ms=6)
    names = ", ".join(module.actuators)
    axes.text(0, -0.03, f"actuators {names}; 1 = extended", ha="center", va="top", fontsize=9, color=DARK)


def draw_platform(axes: Axes, joints: Sequence[Sequence[Sequence[float]]], title: str) -> None:
    """Draws a platform with the numbers of its legs, all contracted; and all extended, in light gray."""
    base, top = joints
    module = platform(base, top, (0.2, 0.24))
    legs, flat = len(module.actuators), module.planar
    bare(axes, title)
    for segment in seen(module.body[-1], flat=flat):
        line(axes, segment, LIGHT, 1.2)
    body = seen(module.body[0], flat=flat)
    for segment in body[legs:]:
        line(axes, segment, DARK, 2.0)
    for segment in body[:legs]:
        line(axes, segment, BLUE, 3.0)
    for name, end, shift, side in (("base", 0, -0.012, "top"), ("top", 1, 0.014, "bottom")):
        places: dict[tuple[float, float], list[str]] = {}
        for k, (x, y) in enumerate(body[:legs, end].round(6).tolist()):
            places.setdefault((x, y), []).append(f"{name}[{k}]" if flat else str(k + 1) if end == 0 else "")
        for (x, y), names in places.items():
            axes.text(x, y + shift, ", ".join(names), ha="center", va=side, fontsize=8, color=DARK)
    for k, segment in enumerate(body[:legs]):
        label(axes, 0.5 * segment[1] + 0.5 * segment[0], module.actuators[k], BLUE, 10)
    if flat:
        draw_frame(axes, module.frames[0], "")
    else:
        axes.text(
            0,
            float(body[..., 1].min()) - 0.05,
            "leg k from base[k - 1] to top[k - 1]",
            ha="center",
            fontsize=9,
            color=DARK,
        )


def draw_tool(axes: Axes) -> None:
    """Draws the last module of an arm, a truss, and the frame of a tool's tip in the module's frame."""
    bare(axes, "tip: the frame of a tool")
    module = vgt("BC", 0.2, LENGTHS, LENGTHS, LENGTHS, base_bar=True)
    tooled = tipped(module, frames.planar(0.05, 0.2, 0.6))
    for segment in module.body[0]:
        line(axes, segment, BLUE, 2.0)
    line(axes, tooled.body[0][-1], DARK, 4.0)
    label(axes, tooled.body[0][-1].mean(axis=0), "tool", DARK, 10)
    draw_frame(axes, module.frames[0], "")
    axes.text(0.06, 0.14, "frame of the\nlast module", fontsize=8, color=ORANGE, va="top")
    axes.text(0.05, -0.03, "position [0.05, 0.2], orientation 0.6", ha="center", va="top", fontsize=9, color=DARK)
    draw_frame(axes, tooled.frames[0], "tip")


def seen(points: Array, *, flat: bool) -> Array:
    """Returns points (..., 3) as seen from the front and above, shape (..., 2); of a flat drawing as they are."""
    if flat:
        return np.asarray(points[..., :2])
    turned = points @ frames.turned((0, 0, 1), 0.3)[:3, :3].T @ frames.turned((1, 0, 0), -1.1)[:3, :3].T
    return np.asarray(turned[..., :2])


def label(axes: Axes, place: Array, text: str, colour: str, size: float) -> None:
    """Writes a text over a line."""
    box = {"boxstyle": "square,pad=0.15", "fc": "white", "ec": "none"}
    axes.text(
        place[0], place[1], text, ha="center", va="center", color=colour, fontsize=size, fontweight="bold", bbox=box
    )


def draw_frame(axes: Axes, frame: Array, name: str, *, above: bool = False) -> None:
    """Draws the x and y axis of a frame (4, 4), and its name at the end of the x axis, or of the y axis if `above`."""
    x, y = frame[:2, 3].tolist()
    for axis in (0, 1):
        along, up = (0.05 * frame[:2, axis]).tolist()
        axes.plot(x + along, y + up, alpha=0)  # annotations do not widen the picture
        arrow = {"arrowstyle": "->", "color": ORANGE, "lw": 1.4, "shrinkA": 0, "shrinkB": 0}
        axes.annotate("", (x + along, y + up), (x, y), arrowprops=arrow)
    along, up = (0.058 * frame[:2, int(above)]).tolist()
    va, ha = ("bottom", "center") if above else ("center", "left")
    axes.text(x + along, y + up, name, fontsize=8, color=ORANGE, va=va, ha=ha)


def bare(axes: Axes, title: str) -> None:
    axes.set_title(title, fontsize=11, fontweight="bold", color=DARK)
    axes.set_aspect("equal")
    axes.axis("off")
    axes.margins(0.14)


def placed(segments: Array, frame: Array) -> Array:
    """Returns line segments (n, 2, 3) of a frame (4, 4) in the world."""
    return np.asarray(segments @ frame[:3, :3].T + frame[:3, 3])


def line(axes: Axes, segment: Sequence[Sequence[float]] | Array, colour: str, width: float) -> None:
    (x0, y0, *_), (x1, y1, *_) = segment
    axes.plot([x0, x1], [y0, y1], color=colour, lw=width, solid_capstyle="round")
