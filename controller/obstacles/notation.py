"""Parses the obstacles of an arm's file or a message; each fault names the path of its field."""

import math
from collections.abc import Sequence

from hyperbit.controller.armfile.settings import BoxSettings, HalfSettings, ObstacleSettings, RoundSettings
from hyperbit.controller.armfile.settings import ObstacleList as ObstacleList  # messages with obstacles use it
from hyperbit.controller.armfile.strict import UNIT
from hyperbit.controller.manipulator import frames
from hyperbit.controller.obstacles.obstacles import Obstacles, box, half_space, sphere, together

PLANAR, SPATIAL = ("disc", "box", "half_plane"), ("sphere", "box", "half_space")


def parse_obstacles(listed: Sequence[ObstacleSettings], dimension: int, path: str, faults: list[str]) -> Obstacles:
    """Returns the valid obstacles of a list, whose path in the file is such as "obstacles".

    A sentence is appended to `faults` for each invalid entry.
    """
    parts = list[Obstacles]()
    for k, entry in enumerate(listed):
        where = f"{path}[{k}]"
        names = [other.name for other in listed[:k]]
        if entry.name is not None and entry.name in names:
            faults.append(f"{where}.name: {entry.name!r} is the name of another obstacle already")
        if (part := parse_obstacle(entry, dimension, where, faults)) is not None:
            parts.append(part)
    return together(parts)


def parse_obstacle(entry: ObstacleSettings, dimension: int, path: str, faults: list[str]) -> Obstacles | None:
    """Returns one obstacle; appends a fault and returns None if the entry is invalid."""
    kinds = PLANAR if dimension == 2 else SPATIAL
    arm = "planar" if dimension == 2 else "spatial"
    given = [kind for kind in dict.fromkeys(PLANAR + SPATIAL) if getattr(entry, kind) is not None]
    if len(given) != 1 or given[0] not in kinds:
        got = " and ".join(given) or "none of them"
        faults.append(f"{path}: one of {', '.join(kinds)} is needed for a {arm} arm, got {got}")
        return None
    kind, settings = given[0], getattr(entry, given[0])
    before = len(faults)
    for field in ("centre", "size", "point", "normal"):
        vector = getattr(settings, field, None)
        if vector is not None and len(vector) != dimension:
            faults.append(f"{path}.{kind}.{field}: {len(vector)} coordinates, a {arm} arm's have {dimension}")
    name = f"{kind.replace('_', '-')} {repr(entry.name) if entry.name else path}"
    match settings:
        case RoundSettings():
            obstacle = None if len(faults) > before else sphere(name, settings.centre, settings.radius)
        case HalfSettings():
            if math.hypot(*settings.normal) < 1e-9:
                faults.append(f"{path}.{kind}.normal: a direction is needed, got {settings.normal}")
            obstacle = None if len(faults) > before else half_space(name, settings.point, settings.normal)
        case BoxSettings():
            rotation = build_rotation(settings, dimension, f"{path}.{kind}", faults)
            obstacle = None if len(faults) > before else box(name, settings.centre, settings.size, rotation)
    return obstacle


def build_rotation(settings: BoxSettings, dimension: int, path: str, faults: list[str]) -> frames.Frame:
    """Returns the rotation (3, 3) of a box."""
    if dimension == 2:
        if settings.orientation is not None:
            faults.append(f"{path}.orientation: a box of the plane is turned by an `angle`, got a quaternion")
        return frames.planar(0.0, 0.0, settings.angle or 0.0)[:3, :3]
    quaternion = settings.orientation or [0.0, 0.0, 0.0, 1.0]
    if settings.angle is not None:
        faults.append(f"{path}.angle: a box in space is turned by an `orientation`, a quaternion x, y, z, w")
    if abs(math.hypot(*quaternion) - 1.0) > UNIT:
        faults.append(f"{path}.orientation: a quaternion x, y, z, w of length 1 is needed, got {quaternion}")
        return frames.spatial((0.0, 0.0, 0.0))[:3, :3]
    return frames.spatial((0.0, 0.0, 0.0), quaternion)[:3, :3]
