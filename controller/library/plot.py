"""Pictures and animations of arms, paths and densities."""

from __future__ import annotations

import base64
import io
from collections.abc import Mapping, Sequence
from html import escape
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from hyperbit.controller.library.arguments import Configurations, Numbers, typed
from hyperbit.controller.library.arm import Arm
from hyperbit.controller.library.errors import ConfigurationError, PictureError
from hyperbit.controller.library.obstacles import Obstacle, build_obstacles
from hyperbit.controller.library.path import Path
from hyperbit.controller.obstacles.obstacles import together
from hyperbit.controller.pictures import plots
from hyperbit.controller.pictures.animation import Film, Movement, film
from hyperbit.controller.search.solution import Solution

if TYPE_CHECKING:  # matplotlib takes half a second to import
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from hyperbit.controller.library.animation import Animation

MOST_DRAWN = len(plots.COLOURS)  # configurations of a path, or of a list

Motion: TypeAlias = "Path | Solution | Configurations | Sequence[object]"  # of configurations and solutions
Drawn: TypeAlias = "Motion | Mapping[str, Solution | Configurations] | None"


@typed(PictureError)
def plot(
    arm: Arm,
    drawn: Drawn = None,
    *,
    obstacles: Sequence[Obstacle] = (),
    targets: Numbers = (),
    title: str | None = None,
    unit: str | None = None,
    density: bool = True,
    ax: Axes | None = None,
) -> Figure:
    """Returns a matplotlib figure: the arm in the world, over the density of its tips if it is planar.

    Args:
        arm: the arm; its own obstacles are drawn as well.
        drawn: a path, a solution or a configuration (B,), a list of these, or these by their names in the legend; None:
            the density only. Of a path and of a list, at most six evenly spaced configurations are drawn.
        obstacles: further obstacles, such as the solver's.
        targets: further positions, drawn as crosses, shape (n, dimension).
        title: title of the picture; None: the arm's name.
        unit: unit of length, for the axes; None: the arm's.
        density: whether to draw the density of a planar arm.
        ax: axes to draw into, for a spatial arm with `projection="3d"`; None: those of a new figure.

    Raises:
        ObstacleError: an obstacle is invalid, or has another dimension than the arm.
        ConfigurationError: the arm has no such configuration.
        PictureError: matplotlib is not installed, or the axes are not for arms of this dimension.
    """
    match drawn:
        case Path():
            given = {f"point {k + 1}": drawn.solutions[k].configuration for k in spaced(len(drawn.solutions))}
        case Solution():
            given = {"solution": drawn.configuration}
        case None:
            given = {}
        case Mapping():
            given = {name: arm.parse(state_of(one)) for name, one in drawn.items()}
        case _:
            rows = rows_of(arm, drawn)
            many = np.atleast_2d(rows)
            given = {f"configuration {k + 1}": many[k] for k in spaced(len(many))}
            given = given if rows.ndim == 2 else {"configuration": rows}
    curve = drawn.positions if isinstance(drawn, Path) else ()
    subplot = plots.Subplot(arm.name if title is None else title, given, np.asarray(targets), curve)
    return scene(arm, subplot, obstacles, unit, density, ax)


@typed(PictureError)
def animate(
    arm: Arm,
    motion: Motion,
    *,
    obstacles: Sequence[Obstacle] = (),
    targets: Numbers = (),
    title: str | None = None,
    unit: str | None = None,
    density: bool = True,
    ax: Axes | None = None,
) -> Animation:
    """Returns a matplotlib animation of an arm that moves through configurations; notebooks show it.

    Actuators that differ move at the same time: stages are not shown. `save("arm.gif")` writes a file. With axes of
    pyplot, `pyplot.show()` shows the animation.

    Args:
        arm: see plot.
        motion: a path, or configurations and solutions, shape (n, B). A path begins at its first goal; the way there is
            shown by `[start, *path.solutions]`.
        obstacles: see plot.
        targets: see plot.
        title: see plot.
        unit: see plot.
        density: see plot.
        ax: see plot.

    Raises:
        ObstacleError: an obstacle is invalid, or has another dimension than the arm.
        ConfigurationError: the arm has no such configuration, or there is none.
        PictureError: see plot.
    """
    rows = np.atleast_2d(motion.configurations if isinstance(motion, Path) else rows_of(arm, motion))
    if not len(rows):
        raise ConfigurationError("motion: at least one configuration is needed, got none")
    pauses = motion.waypoints.tolist() if isinstance(motion, Path) else [len(rows) - 1]
    curve = motion.positions if isinstance(motion, Path) else ()
    around = arm._whole.body(rows).reshape(-1, 3)
    subplot = plots.Subplot(arm.name if title is None else title, {}, np.asarray(targets), curve, around)
    figure = scene(arm, subplot, obstacles, unit, density, ax)
    from hyperbit.controller.library.animation import Animation

    movement = Movement(list(arm.actuator_states(rows)), pauses)
    return Animation(film(figure, arm._whole, movement) if ax is None else Film(ax, arm._whole, movement))


def scene(
    arm: Arm, subplot: plots.Subplot, obstacles: Sequence[Obstacle], unit: str | None, density: bool, ax: Axes | None
) -> Figure:
    """Returns the figure of a subplot; for the other arguments see plot."""
    require_matplotlib()
    unit, planar = arm.unit if unit is None else unit, arm.dimension == 2
    regions = together([arm._arm.obstacles, build_obstacles(obstacles, arm.dimension)])
    if (count := np.shape(subplot.targets))[-1:] not in ((0,), (arm.dimension,)) or len(count) > 2:
        raise PictureError(f"targets: positions of shape (n, {arm.dimension}) are needed, got shape {count}")
    densities = arm._densities if density and planar else None
    if ax is None:
        return plots.figure(arm._whole, densities, [subplot], unit, regions)
    if planar == (ax.name == "3d"):
        kind = "planar, and needs flat axes" if planar else 'spatial, and needs axes with projection="3d"'
        raise PictureError(f"ax: this arm is {kind}")
    if planar:
        plots.draw(ax, arm._whole, densities, subplot, unit, regions)
    else:
        plots.draw_spatial(ax, arm._whole, subplot, unit, regions)
    if (figure := ax.get_figure(root=True)) is None:
        raise PictureError("ax: these axes are of no figure any more")
    return figure


def require_matplotlib() -> None:
    """Raises PictureError if matplotlib is not installed."""
    if find_spec("matplotlib") is None:
        raise PictureError("pictures need matplotlib: pip install 'hyperbit[pictures]'")


def rows_of(arm: Arm, drawn: Solution | Configurations | Sequence[object]) -> NDArray[np.int64]:
    """Returns a configuration (B,), or a list of configurations and solutions as an array (n, B)."""
    if isinstance(drawn, list | tuple) and any(isinstance(one, Solution) for one in drawn):
        return np.array([arm.parse(state_of(one)) for one in drawn])
    return arm._rows(state_of(drawn))


def state_of(one: Any) -> Configurations:
    """Returns the configuration of a solution, and a configuration as it is."""
    return one.configuration if isinstance(one, Solution) else one


def spaced(count: int) -> list[int]:
    """Returns at most MOST_DRAWN evenly spaced indices."""
    return sorted({round(k) for k in np.linspace(0, count - 1, min(count, MOST_DRAWN)).tolist()})


def html(text: str, arm: Arm, obstacles: Sequence[Obstacle] = ()) -> str:
    """Returns HTML for notebooks: a text over a picture of the arm's `home`, without density."""
    head = f"<p><code>{escape(text)}</code></p>"
    if find_spec("matplotlib") is None:
        return head
    picture = io.BytesIO()
    plot(arm, {"home": arm.home}, obstacles=obstacles, density=False).savefig(picture, dpi=60, format="png")
    data = base64.b64encode(picture.getvalue()).decode()
    return f'{head}<img alt="{escape(arm.name)}" src="data:image/png;base64,{data}">'
