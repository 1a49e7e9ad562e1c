"""Pictures of studies of designs: actuators against switches, and the arms of the front."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hyperbit.controller.manipulator.manipulator import Manipulator
from hyperbit.controller.obstacles.obstacles import Obstacles
from hyperbit.controller.pictures.plots import Subplot, draw, draw_spatial

if TYPE_CHECKING:  # matplotlib takes half a second to import
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

COLUMNS = 5  # of small arms
SHADES = "viridis"


class DrawnArm(NamedTuple):
    """An arm of the front, or one for comparison, with actuators, switches and share of reached targets."""

    name: str
    manipulator: Manipulator
    obstacles: Obstacles
    point: tuple[float, float, float]
    compared: bool


def draw_designs(title: str, designs: NDArray[np.float64], arms: Sequence[DrawnArm], targets: object) -> Figure:
    """Returns a picture of a study.

    Args:
        title: of the picture.
        designs: actuators, switches and share of reached targets of each design, shape (n, 3).
        arms: those of the front, and those for comparison.
        targets: positions, shape (m, 2) or (m, 3).
    """
    from hyperbit.controller.pictures.picture import Picture

    rows = math.ceil(len(arms) / COLUMNS)
    figure = Picture(figsize=(11, 5.5 + 2.6 * rows), layout="constrained")
    grid = figure.add_gridspec(1 + rows, COLUMNS, height_ratios=[5.5, *[2.6] * rows])
    draw_front(figure.add_subplot(grid[0, :]), title, designs, arms)
    for k, arm in enumerate(arms):
        place = grid[1 + k // COLUMNS, k % COLUMNS]
        home = np.zeros(len(arm.manipulator.modules), dtype=np.int64)
        middle = arm.manipulator.states // 2
        subplot = Subplot(arm.name, {"home": home, "middle": middle}, targets)  # type: ignore[arg-type]
        if arm.manipulator.planar:
            axes = figure.add_subplot(place)
            draw(axes, arm.manipulator, None, subplot, obstacles=arm.obstacles)
        else:
            axes = figure.add_subplot(place, projection="3d")
            draw_spatial(axes, arm.manipulator, subplot, obstacles=arm.obstacles)
        small(axes)
    return figure


def draw_front(axes: Axes, title: str, designs: NDArray[np.float64], arms: Sequence[DrawnArm]) -> None:
    """Draws the designs as dots of their share of reached targets, and the arms with their names."""

    def dots(points: NDArray[np.float64], size: int, **style: Any) -> Any:
        rows = points.reshape(-1, 3)
        return axes.scatter(rows[:, 0], rows[:, 1], size, rows[:, 2], cmap=SHADES, vmin=0, vmax=1, **style)

    shown = dots(designs, 22, zorder=2)
    for compared, marker, label in ((False, "o", "front"), (True, "D", "for comparison")):
        own = [arm for arm in arms if arm.compared == compared]
        if own:
            dots(np.array([arm.point for arm in own]), 80, zorder=3, marker=marker, edgecolors="black", label=label)
        for arm in own:
            text = arm.name if compared else arm.name.rpartition("-")[2]
            axes.annotate(text, arm.point[:2], textcoords="offset points", xytext=(6, 5), fontsize=8)
    axes.set(title=title, xlabel="actuators", ylabel="switches from target to target, mean")
    axes.grid(alpha=0.3)
    if arms:
        axes.legend(loc="upper left")
    axes.figure.colorbar(shown, ax=axes, label="share of targets reached")


def small(axes: Axes) -> None:
    """Takes labels and legend from the axes of a small picture."""
    axes.set(xlabel="", ylabel="", **({"zlabel": ""} if axes.name == "3d" else {}))
    axes.tick_params(labelsize=6)
    axes.title.set_fontsize(9)
    if (legend := axes.get_legend()) is not None:
        legend.remove()
