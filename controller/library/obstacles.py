"""Obstacles: convex regions in the world that no module may touch."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from hyperbit.controller.armfile.settings import ObstacleSettings
from hyperbit.controller.armfile.strict import check
from hyperbit.controller.library.arguments import Number, Numbers, told, typed
from hyperbit.controller.library.errors import ObstacleError
from hyperbit.controller.obstacles.notation import parse_obstacles
from hyperbit.controller.obstacles.obstacles import Obstacles


@dataclass(frozen=True, eq=False)
class Obstacle:
    """Base of all obstacles. An obstacle keeps read-only copies of arrays."""

    def __post_init__(self) -> None:
        """Copies arrays, which the caller may change later."""
        for name, value in vars(self).items():
            if isinstance(value, np.ndarray):
                copy = value.copy()
                copy.flags.writeable = False
                object.__setattr__(self, name, copy)


@typed(ObstacleError)
@dataclass(frozen=True, eq=False)
class _Round(Obstacle):
    centre: Numbers
    radius: Number
    name: str | None = None


@typed(ObstacleError)
@dataclass(frozen=True, eq=False)
class _Half(Obstacle):
    point: Numbers
    normal: Numbers
    name: str | None = None


class Disc(_Round):
    """A disc, for planar arms.

    Attributes:
        centre: shape (2,), in the arm's unit of length.
        radius: in the same unit.
        name: name of the obstacle in messages.
    """


class Sphere(_Round):
    """A sphere, for spatial arms.

    Attributes:
        centre: shape (3,), in the arm's unit of length.
        radius: in the same unit.
        name: name of the obstacle in messages.
    """


@typed(ObstacleError)
@dataclass(frozen=True, eq=False)
class Box(Obstacle):
    """A box, for planar and spatial arms.

    Attributes:
        centre: shape (2,) or (3,), in the arm's unit of length.
        size: lengths of the sides along the box's axes, same shape.
        angle: angle of the box, for planar arms [rad].
        orientation: orientation of the box, for spatial arms, a unit quaternion x, y, z, w, shape (4,).
        name: name of the obstacle in messages.
    """

    centre: Numbers
    size: Numbers
    angle: Number | None = None
    orientation: Numbers | None = None
    name: str | None = None


class HalfPlane(_Half):
    """The region behind a line, for planar arms.

    Attributes:
        point: on the line, shape (2,), in the arm's unit of length.
        normal: points away from the obstacle, shape (2,), of any length but 0.
        name: name of the obstacle in messages.
    """


class HalfSpace(_Half):
    """The region behind a plane, for spatial arms.

    Attributes:
        point: on the plane, shape (3,), in the arm's unit of length.
        normal: points away from the obstacle, shape (3,), of any length but 0.
        name: name of the obstacle in messages.
    """


KINDS: dict[type[Obstacle], str] = {
    Disc: "disc",
    Sphere: "sphere",
    Box: "box",
    HalfPlane: "half_plane",
    HalfSpace: "half_space",
}


def obstacle_settings(obstacle: Obstacle, faults: list[str]) -> ObstacleSettings | None:
    """Returns an obstacle in the form of an arm's file; None after appending its faults to `faults`."""
    if type(obstacle) not in KINDS:
        faults.append(f"obstacles: one of {', '.join(kind.__name__ for kind in KINDS)} is needed, got {told(obstacle)}")
        return None
    fields: dict[str, Any] = {k: v for k, v in asdict(obstacle).items() if v is not None}
    name = {"name": fields.pop("name")} if "name" in fields else {}
    try:
        body = {k: np.asarray(v, dtype=float).tolist() for k, v in fields.items()}
    except (TypeError, ValueError):
        faults.append(f"obstacles: numbers are needed, got {obstacle!r}")
        return None
    return check({KINDS[type(obstacle)]: body, **name}, ObstacleSettings, faults)


def build_obstacles(obstacles: Sequence[Obstacle], dimension: int) -> Obstacles:
    """Returns obstacles in the form of the collision checks.

    Args:
        obstacles: the obstacles.
        dimension: dimension of the arm, 2 or 3.

    Raises:
        ObstacleError: an obstacle is not valid, or does not suit the dimension.
    """
    faults: list[str] = []
    listed = [obstacle_settings(obstacle, faults) for obstacle in obstacles]
    given = [entry for entry in listed if entry is not None]
    regions = parse_obstacles(given, dimension, "obstacles", faults)
    if faults:
        raise ObstacleError("\n".join(faults))
    return regions
