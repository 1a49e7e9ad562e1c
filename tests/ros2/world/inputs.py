"""Inputs of the bridge: valid messages, messages that break a rule, mutated ones and random bytes."""

import json
import random
import struct
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

from hyperbit.controller.ros2.wire.cdr import HEADER, serialize
from hyperbit.controller.ros2.wire.types import Types
from tests import told
from tests.fuzz.mutations import NUMBERS, changed, mutated, spoiled

TYPES = Types("jazzy")
ACTION = "control_msgs/action/FollowJointTrajectory"
ACTUATORS = "actuator_controller/follow_joint_trajectory/_action"
TIP = "tip_controller/follow_joint_trajectory/_action"
STAMPED, TRIGGER = "geometry_msgs/msg/PoseStamped", "std_srvs/srv/Trigger_Request"
# Kind of an input by name of its topic or service, and type of its messages.
KINDS = {
    "goal_pose": ("goal_pose", STAMPED),
    "goal_path": ("goal_path", "nav_msgs/msg/Path"),
    "setpoint": ("setpoint", STAMPED),
    **{key: (key, TRIGGER) for key in ("stop", "reset", "cancel")},
    "plan": ("plan", "nav_msgs/srv/GetPlan_Request"),
    f"{TIP}/send_goal": ("tip", f"{ACTION}_SendGoal_Request"),
    f"{ACTUATORS}/send_goal": ("actuators", f"{ACTION}_SendGoal_Request"),
    **{f"{it}/cancel_goal": ("cancel_goal", "action_msgs/srv/CancelGoal_Request") for it in (TIP, ACTUATORS)},
    **{f"{it}/get_result": ("get_result", f"{ACTION}_GetResult_Request") for it in (TIP, ACTUATORS)},
}
NAMES = tuple(KINDS)
ENDINGS = ("stop", "cancel", f"{TIP}/cancel_goal", f"{ACTUATORS}/cancel_goal")
TEXTS = ("", "world", "planar16/0", "map", "planar16/1", "\0", "ä" * 3, "w" * 5000, "tip_x", "\x1b[2J\n", "%s{}")
ATTACHMENT = struct.pack("<qqB", 1, 10**18, 16) + bytes(16)
TEMPLATES, UUIDS = 40, 200  # messages of each kind that are changed; ids of goals
NO_GOAL = "ros2-" + "00" * 16


class Input(NamedTuple):
    name: str
    payload: bytes
    attachment: bytes | None = ATTACHMENT


def daemon_messages() -> dict[str, Any]:
    """Returns a message of each key that the bridge hears."""
    own = {"state": {"goal": NO_GOAL}, "result": {"id": NO_GOAL}, "feedback": {"id": NO_GOAL}}
    keys = ("arm", "state", "result", "feedback", "diagnostics")
    heard = {key: told.published()[key] | own.get(key, {}) for key in keys}
    return heard | {"alive": {}, "gone": {}, "clearance": {}}


class Inputs:
    def __init__(self, chance: random.Random) -> None:
        self.chance = chance
        self.uuids = [chance.randbytes(16) for _ in range(UUIDS)]
        self._templates = {
            name: [serialize(self._fields(kind), form, TYPES) for _ in range(TEMPLATES)]
            for name, (kind, form) in KINDS.items()
        }
        self._told = {key: json.dumps(value).encode() for key, value in daemon_messages().items()}

    def message(self, now: float) -> Input:
        chance = self.chance
        name = chance.choice(NAMES)
        payload = bytearray(chance.choice(self._templates[name]))
        if name.endswith(("send_goal", "get_result", "cancel_goal")) and chance.random() < 0.9:
            payload[4:20] = chance.choice(self.uuids) if chance.random() < 0.7 else chance.randbytes(16)
        elif name in ("goal_pose", "goal_path", "setpoint") and chance.random() < 0.5:
            payload[4:12] = struct.pack("<iI", int(now) + chance.choice((0, 0, 2, -2, 6, -6, 400)), 500_000_000)
        data, kind, good = bytes(payload), chance.random(), chance.random()
        if kind > 0.98:
            data = chance.choice((HEADER, b"")) + chance.randbytes(chance.choice((0, 1, 3, 4, 40, 400)))
        elif kind > 0.5:
            for _ in range(chance.choice((1, 1, 1, 2, 4))):
                data = changed(data, chance)
        attachment = ATTACHMENT if good < 0.95 else None if good < 0.97 else changed(ATTACHMENT, chance)
        return Input(name, data, attachment)

    def token(self, tokens: Sequence[str]) -> str:
        """Returns a token of a stranger: much like one of `tokens`, or any text."""
        chance = self.chance
        if chance.random() < 0.05:
            return chance.choice(TEXTS)
        parts = chance.choice(tokens).split("/")
        parts[2] = chance.choice(("beef", "f00d", ""))
        if len(parts) > 11 and chance.random() < 0.7:
            parts[11] = chance.choice(("TypeHashNotSupported", "RIHS01_" + "0" * 64, *TEXTS))
            parts[5] = {"MS": "MP", "MP": "MS", "SS": "SC"}[parts[5]]
        if chance.random() < 0.3:
            parts[chance.randrange(len(parts))] = chance.choice((*TEXTS, "99999999999", "::,,:"))
        return "/".join(parts)

    def daemon_message(self) -> tuple[str, bytes, bool]:
        """Returns key and payload of a message on the daemon's keys, and whether it may be the daemon's."""
        key, kind = self.chance.choice(tuple(self._told)), self.chance.random()
        if kind < 0.4:
            return key, self._told[key], True
        if kind < 0.8:
            return key, json.dumps(spoiled(json.loads(self._told[key]), self.chance)).encode("utf-8", "replace"), False
        return key, mutated(self._told[key], self.chance), False

    def _fields(self, kind: str) -> dict[str, Any]:
        """Returns the fields of a message, which may break a rule of its content."""
        chance = self.chance
        builders: dict[str, Callable[[], dict[str, Any]]] = {
            "goal_pose": self._pose,
            "setpoint": self._pose,
            "goal_path": lambda: {
                "header": self._header(),
                "poses": [self._pose(k) for k in range(chance.choice((0, 1, 2, 5, 50)))],
            },
            "plan": lambda: {
                "start": self._pose(),
                "goal": self._pose(),
                "tolerance": chance.choice((-1.0, 0.0, 0.01)),
            },
            "tip": lambda: {"goal": self._trajectory(kind)},
            "actuators": lambda: {"goal": self._trajectory(kind)},
            "cancel_goal": lambda: {"goal_info": {"stamp": {"sec": chance.choice((0, 0, 1, 2**31 - 1, -1))}}},
        }
        return builders.get(kind, dict)()

    def _number(self) -> float:
        return self.chance.choice(NUMBERS) if self.chance.random() < 0.1 else self.chance.uniform(-3, 3)

    def _header(self, sec: int = 0) -> dict[str, Any]:
        frame = self.chance.choice(TEXTS if self.chance.random() < 0.1 else TEXTS[:3])
        return {"frame_id": frame, "stamp": {"sec": sec}}

    def _pose(self, sec: int = 0) -> dict[str, Any]:
        turn = {"z": 0.6, "w": self._number() if self.chance.random() < 0.1 else 0.8}
        position = {it: self._number() for it in "xyz"}
        return {"header": self._header(sec), "pose": {"position": position, "orientation": turn}}

    def _trajectory(self, kind: str) -> dict[str, Any]:
        chance = self.chance
        actuators = told.arm().manipulator.actuators
        tips = (["tip_x", "tip_y"], ["tip_y", "tip_x"], ["tip_x", "tip_y", "tip_yaw"])
        odd = ([], ["tip_x"], ["tip_x", "tip_x"], ["elbow"], list(TEXTS), ["w" * 100_000, "tip_x"])
        joints = chance.choice(tips) if kind == "tip" else chance.sample(actuators, chance.choice((1, 5, 48)))
        joints = chance.choice(odd) if chance.random() < 0.1 else joints
        value = self._number if kind == "tip" else lambda: float(chance.randrange(2))
        rows = [[value() for _ in joints] for _ in range(chance.choice((0, 1, 1, 2, 20)))]
        if rows and chance.random() < 0.1:
            rows[-1] = [self._number(), *rows[-1][chance.randrange(2) :]]
        points = [{"positions": row, "time_from_start": {"sec": k}} for k, row in enumerate(rows)]
        fields: dict[str, Any] = {"trajectory": {"header": self._header(), "joint_names": joints, "points": points}}
        for name, share in (("goal_tolerance", 0.2), ("path_tolerance", 0.1)):
            if chance.random() < share:
                fields[name] = [{"name": chance.choice(("tip_x", *TEXTS)), "position": self._number()}]
        if chance.random() < 0.1:
            fields["goal_time_tolerance"] = {"sec": chance.choice((-5, -1, 0, 0, 1, 20)), "nanosec": 1}
        return fields
