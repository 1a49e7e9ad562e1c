"""A small arm in the plane, its description and states, and messages of ROS 2, for tests without a network."""

import functools
import json
from typing import Any

import numpy as np

from hyperbit.controller.arm.arm import load
from hyperbit.controller.arm.description import description, drawing
from hyperbit.controller.manipulator.manipulator import Manipulator
from hyperbit.controller.manipulator.notation import format_configuration, pose
from hyperbit.controller.ros2.poses import Place
from hyperbit.controller.ros2.wire.cdr import message
from hyperbit.controller.ros2.wire.types import Types
from tests.keys import DEPLOY

TYPES = Types("jazzy")
ACTION = "control_msgs/action/FollowJointTrajectory"


@functools.cache
def told(name: str = "planar16") -> dict[str, Any]:
    arm = load(DEPLOY / f"{name}.yaml")
    return {**description(arm), "drawing": drawing(arm)}


@functools.cache
def chain(name: str = "planar16") -> Manipulator:
    return load(DEPLOY / f"{name}.yaml").manipulator


def place(base: Any = None, dimension: int = 2) -> Place:
    return Place("world", "planar16", np.eye(4) if base is None else base, dimension)


def state(name: str = "planar16", **fields: Any) -> dict[str, Any]:
    manipulator = chain(name)
    home = np.zeros(len(manipulator.modules), np.int64)
    bits = [int(bit) for module in manipulator.modules for bit in module.bits[0]]
    return {
        **{"stamp": 1.5e9, "mode": "ready", "reason": "holding", "simulated": True, "goal": None, "target": None},
        **{"commanded": bits, "measured": bits, "faults": [], "degraded": [], "obstacles": 0},
        **{"configuration": format_configuration(manipulator, home), "tip": pose(manipulator, manipulator.tip(home))},
        **fields,
    }


def message_bytes(goal: dict[str, Any]) -> bytes:
    return json.dumps(goal).encode()


def pose_stamped(x: float, y: float, z: float = 0.0, **header: Any) -> Any:
    fields = {"header": header, "pose": {"position": {"x": x, "y": y, "z": z}}}
    return message(fields, "geometry_msgs/msg/PoseStamped", TYPES)


def trajectory_goal(joints: list[str], rows: list[list[float]], **fields: Any) -> Any:
    """A goal of FollowJointTrajectory, a point a second."""
    points = [{"positions": row, "time_from_start": {"sec": k}} for k, row in enumerate(rows)]
    given = {"joint_names": joints, "points": points, **fields.pop("trajectory", {})}
    return message({"trajectory": given, **fields}, f"{ACTION}_Goal", TYPES)
