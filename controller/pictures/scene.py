"""The arm's drawing for Foxglove: frames of all modules, and entities of modules, goal and obstacles.

The frame of each module is a child of the frame before it. A module is drawn in the frame before it, in its measured
state, so that its entity changes only with its own actuators. All lengths are metres, as Foxglove and ROS 2 want them.
"""

import itertools
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hyperbit.controller.armfile.units import metres_of
from hyperbit.controller.manipulator.described import base_of, in_metres, structure_of
from hyperbit.controller.messages.arm import Description
from hyperbit.controller.messages.parts import Pose
from hyperbit.controller.messages.state import ActuatorState, State

Colour = tuple[float, float, float, float]

# Colours of Okabe and Ito, which colour-blind readers can distinguish.
MEASURED: Colour = (0.0, 0.45, 0.7, 1.0)
TRAVELLING: Colour = (0.84, 0.37, 0.0, 1.0)
UNKNOWN: Colour = (0.5, 0.5, 0.5, 1.0)
GOAL: Colour = (0.0, 0.62, 0.45, 1.0)
OBSTACLE: Colour = (0.8, 0.47, 0.65, 0.4)
THICKNESS = 3.0  # [pixels]
GOAL_SIZE = 0.015  # of the arm's length
THIN = 0.002  # of the arm's length: height of planar obstacles
FAR = 4.0  # of the arm's length: sides of a half-plane or half-space
PARTS = ("arrows", "cubes", "spheres", "cylinders", "lines", "triangles", "texts", "models")


class Shown(NamedTuple):
    """The fields of `state` on which the drawing depends."""

    commanded: list[ActuatorState] | None
    measured: list[ActuatorState] | None
    target: Pose | None


def shown_of(state: State) -> Shown:
    return Shown(state.commanded, state.measured, state.target)


class FoxgloveScene:
    """Draws an arm in any state, from its description with `drawing`.

    Raises LookupError, TypeError or ValueError if a part is missing, or the parts are not of one arm.
    """

    def __init__(self, arm: Description) -> None:
        self._metres = metres_of(arm.unit)  # of a unit of the daemon's messages
        arm = in_metres(arm)
        self._name, self._planar, self._length = arm.name, arm.dimension == 2, arm.length
        self._base = base_of(arm)
        self._frames = [np.array(frames, dtype=float).reshape(-1, 4, 4) for frames in arm.frames]
        structure = structure_of(arm)
        self._bits = [np.array(kind.bits, dtype=int) for kind in structure]
        self._bodies = [np.array(kind.body, dtype=float) for kind in structure]
        self._ends = list(itertools.accumulate(bits.shape[1] for bits in self._bits))
        self._obstacles = [*arm.obstacles, *arm.sent_obstacles]
        if len(self._frames) != len(structure) or len(arm.actuators) != self._ends[-1]:
            raise ValueError("frames, drawing and actuators are not of one arm")

    def transforms(self, shown: Shown, stamp: float) -> dict[str, Any]:
        """Returns the FrameTransforms at a UNIX time [s]."""
        names, chosen = [f"{self._name}/{k}" for k in range(len(self._bits) + 1)], self._configuration(shown)
        frames = [self._base, *(own[k] for own, (k, _) in zip(self._frames, chosen, strict=True))]
        return {
            "transforms": [
                {
                    "timestamp": time_of(stamp),
                    "parent_frame_id": parent,
                    "child_frame_id": child,
                    "translation": vector(frame[:3, 3]),
                    "rotation": quaternion(frame[:3, :3]),
                }
                for parent, child, frame in zip(["world", *names], names, frames, strict=False)
            ]
        }

    def update(self, shown: Shown, stamp: float) -> dict[str, Any]:
        """Returns the SceneUpdate at a UNIX time [s]; its entities replace all earlier ones."""
        entities = []
        for m, (k, colour) in enumerate(self._configuration(shown)):
            segments = self._bodies[m][k]
            lines = {
                "type": 2,  # a line for each two points
                "pose": pose(),
                "thickness": THICKNESS,
                "scale_invariant": True,
                "points": [vector(point) for point in segments.reshape(-1, 3)],
                "color": rgba(colour),
                "colors": [],
                "indices": [],
            }
            entities.append(entity(f"module {m + 1}", f"{self._name}/{m}", stamp, lines=[lines]))
        size = self._length * GOAL_SIZE
        centre = [] if shown.target is None else [x * self._metres for x in shown.target.position]
        spheres = [{**solid(centre, [size] * 3), "color": rgba(GOAL)}] if centre else []
        entities.append(entity("goal", "world", stamp, spheres=spheres))
        entities.append(entity("obstacles", "world", stamp, **self._regions()))
        return {"deletions": [], "entities": entities}

    def _configuration(self, shown: Shown) -> list[tuple[int, Colour]]:
        """Returns state and colour of each module: the measured state, else the commanded, else the first state."""
        measured = shown.measured or [None] * self._ends[-1]
        commanded = shown.commanded or [None] * self._ends[-1]
        result = []
        for bits, begin, end in zip(self._bits, [0, *self._ends], self._ends, strict=False):
            own, wanted = measured[begin:end], commanded[begin:end]
            state_of, colour = row(bits, own), MEASURED if own == wanted else TRAVELLING
            if state_of is None:
                state_of, colour = row(bits, wanted) or 0, UNKNOWN
            result.append((state_of, colour))
        return result

    def _regions(self) -> dict[str, list[dict[str, Any]]]:
        """Returns the primitives of all obstacles of known kinds."""
        parts: dict[str, list[dict[str, Any]]] = {"cubes": [], "spheres": [], "cylinders": []}
        thin, far = THIN * self._length, FAR * self._length
        for region in self._obstacles:
            match next(((shape, it) for shape, it in region.items() if shape != "name" and it is not None), None):
                case ("disc", it):
                    size = [2 * it["radius"], 2 * it["radius"], thin]
                    parts["cylinders"].append({**solid(it["centre"], size), "bottom_scale": 1.0, "top_scale": 1.0})
                case ("sphere", it):
                    parts["spheres"].append(solid(it["centre"], [2 * it["radius"]] * 3))
                case ("box", it):
                    half = (it.get("angle") or 0.0) / 2
                    turned = it.get("orientation") or [0.0, 0.0, np.sin(half), np.cos(half)]
                    parts["cubes"].append(solid(it["centre"], [*it["size"], thin][:3], turned))
                case ("half_plane" | "half_space", it):
                    point, normal = (np.array([*it[key], 0.0][:3], dtype=float) for key in ("point", "normal"))
                    normal /= np.linalg.norm(normal)
                    size = [far, far, thin if self._planar else far]
                    parts["cubes"].append(solid((point - normal * far / 2).tolist(), size, turn_to(normal)))
                case _:
                    pass
        for primitive in itertools.chain(*parts.values()):
            primitive["color"] = rgba(OBSTACLE)
        return parts


def row(codes: NDArray[np.int64], states: Sequence[int | None]) -> int | None:
    """Returns the index of the first row of codes (K, A) that equals states (A,); None if there is none."""
    if None in states:
        return None
    found = np.flatnonzero((codes == np.array(states)).all(axis=1))
    return int(found[0]) if len(found) else None


def entity(name: str, frame: str, stamp: float, **primitives: list[Any]) -> dict[str, Any]:
    """Returns a SceneEntity without expiry."""
    head = {"timestamp": time_of(stamp), "frame_id": frame, "id": name, "lifetime": {"sec": 0, "nsec": 0}}
    return {**head, "frame_locked": True, "metadata": [], **{part: [] for part in PARTS}, **primitives}


def solid(centre: Sequence[float], size: Sequence[float], turned: Sequence[float] = (0, 0, 0, 1)) -> dict[str, Any]:
    """Returns pose and size of a primitive; its centre has two or three coordinates."""
    return {"pose": pose([*centre, 0.0][:3], turned), "size": vector(size)}


def pose(position: Sequence[float] = (0, 0, 0), turned: Sequence[float] = (0, 0, 0, 1)) -> dict[str, Any]:
    """Returns a pose from position (3,) and quaternion x, y, z, w."""
    return {"position": vector(position), "orientation": dict(zip("xyzw", map(float, turned), strict=True))}


def vector(values: Sequence[float] | NDArray[np.float64]) -> dict[str, float]:
    return dict(zip("xyz", (round(float(v), 9) for v in values), strict=True))


def rgba(colour: Colour) -> dict[str, float]:
    return dict(zip("rgba", colour, strict=True))


def time_of(stamp: float) -> dict[str, int]:
    """Returns a UNIX time [s] as fields sec and nsec."""
    seconds = int(stamp)
    return {"sec": seconds, "nsec": int((stamp - seconds) * 1e9)}


def quaternion(rotation: NDArray[np.float64]) -> dict[str, float]:
    """Returns the unit quaternion of a rotation matrix (3, 3) by Bar-Itzhack's method."""
    (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = rotation
    symmetric = np.array(
        [
            [xx - yy - zz, 0, 0, 0],
            [yx + xy, yy - xx - zz, 0, 0],
            [zx + xz, zy + yz, zz - xx - yy, 0],
            [zy - yz, xz - zx, yx - xy, xx + yy + zz],
        ]
    )
    _, vectors = np.linalg.eigh(symmetric)  # reads the lower triangle
    largest = vectors[:, -1] * (1.0 if vectors[3, -1] >= 0 else -1.0)
    return dict(zip("xyzw", (round(float(v), 9) for v in largest), strict=True))


def turn_to(normal: NDArray[np.float64]) -> list[float]:
    """Returns the quaternion that rotates the x axis onto a unit vector (3,)."""
    if normal[0] < -1.0 + 1e-12:
        return [0.0, 0.0, 1.0, 0.0]
    half = np.array([0.0, -normal[2], normal[1], 1.0 + normal[0]])
    return [float(v) for v in half / np.linalg.norm(half)]
