"""Pictures of arms, paths and densities."""

from __future__ import annotations

import base64
import io
from collections.abc import Mapping, Sequence
from html import escape
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from hyperbit.controller.library.arm import Arm
from hyperbit.controller.library.obstacles import Obstacle, build_obstacles
from hyperbit.controller.library.path import Path
from hyperbit.controller.obstacles.obstacles import together
from hyperbit.controller.pictures import plots
from hyperbit.controller.search.solution import Solution

if TYPE_CHECKING:  # matplotlib takes half a second to import
    from matplotlib.figure import Figure

MOST_DRAWN = len(plots.COLOURS)  # configurations of a path

Drawn = Path | Solution | Mapping[str, ArrayLike] | None


def plot(
    arm: Arm,
    drawn: Drawn = None,
    *,
    obstacles: Sequence[Obstacle] = (),
    targets: ArrayLike = (),
    title: str | None = None,
    unit: str | None = None,
    density: bool = True,
) -> Figure:
    """Returns a matplotlib figure: the arm in the world, over the density of its tips if it is planar.

    Args:
        arm: the arm; its own obstacles are drawn as well.
        drawn: a path, a solution, configurations (B,) by their names in the legend, or None for the density only. Of a
            path, its goals and at most six evenly spaced configurations are drawn.
        obstacles: further obstacles, such as the solver's.
        targets: further positions, drawn as crosses, shape (n, dimension).
        title: title of the picture; None: the arm's name.
        unit: unit of length, for the axes; None: the arm's.
        density: whether to draw the density of a planar arm.

    Raises:
        ObstacleError: an obstacle is invalid, or has another dimension than the arm.
        ConfigurationError: the arm has no such configuration.
    """
    curve: ArrayLike = ()
    unit = arm.unit if unit is None else unit
    match drawn:
        case Path():
            curve = drawn.positions
            chosen = np.unique(np.linspace(0, len(drawn.solutions) - 1, MOST_DRAWN).round().astype(int))
            given = {f"point {k + 1}": drawn.solutions[k].configuration for k in chosen.tolist()}
        case Solution():
            given = {"solution": drawn.configuration}
        case None:
            given = {}
        case _:
            given = {name: arm.parse(configuration) for name, configuration in drawn.items()}
    regions = together([arm._arm.obstacles, build_obstacles(obstacles, arm.dimension)])
    subplot = plots.Subplot(arm.name if title is None else title, given, targets, curve)
    if arm.dimension == 2:
        return plots.figure(arm._whole, arm._densities if density else None, [subplot], unit, regions)
    from matplotlib.figure import Figure

    figure = Figure(figsize=(6.6, 6.2), layout="constrained")
    plots.draw_spatial(figure.add_subplot(projection="3d"), arm._whole, subplot, unit, regions)
    return figure


def html(text: str, arm: Arm, obstacles: Sequence[Obstacle] = ()) -> str:
    """Returns HTML for notebooks: a text over a picture of the arm's `home`, without density."""
    picture = io.BytesIO()
    plot(arm, {"home": arm.home}, obstacles=obstacles, density=False).savefig(picture, dpi=60, format="png")
    data = base64.b64encode(picture.getvalue()).decode()
    return f'<p><code>{escape(text)}</code></p><img alt="{escape(arm.name)}" src="data:image/png;base64,{data}">'
