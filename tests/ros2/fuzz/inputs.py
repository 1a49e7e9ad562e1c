"""Inputs of the bridge: valid messages, messages that break a rule, mutated ones and random bytes."""

import functools
import json
import math
import random
import struct
from collections.abc import Sequence
from typing import Any, NamedTuple

from hyperbit.controller.ros2.wire.cdr import HEADER, serialize
from tests.ros2.samples import ACTION, TYPES, chain, state, told

ACTUATORS = "actuator_controller/follow_joint_trajectory/_action"
TIP = "tip_controller/follow_joint_trajectory/_action"
STAMPED, PATH, TRIGGER = "geometry_msgs/msg/PoseStamped", "nav_msgs/msg/Path", "std_srvs/srv/Trigger_Request"
# Kind of an input by name of its topic or service, and type of its messages.
KINDS = {
    "goal_pose": ("goal_pose", STAMPED),
    "goal_path": ("goal_path", PATH),
    "setpoint": ("setpoint", STAMPED),
    "stop": ("stop", TRIGGER),
    "reset": ("reset", TRIGGER),
    "cancel": ("cancel", TRIGGER),
    "plan": ("plan", "nav_msgs/srv/GetPlan_Request"),
    f"{TIP}/send_goal": ("tip", f"{ACTION}_SendGoal_Request"),
    f"{ACTUATORS}/send_goal": ("actuators", f"{ACTION}_SendGoal_Request"),
    **{f"{it}/cancel_goal": ("cancel_goal", "action_msgs/srv/CancelGoal_Request") for it in (TIP, ACTUATORS)},
    **{f"{it}/get_result": ("get_result", f"{ACTION}_GetResult_Request") for it in (TIP, ACTUATORS)},
}
NAMES = tuple(KINDS)
ENDINGS = ("stop", "cancel", f"{TIP}/cancel_goal", f"{ACTUATORS}/cancel_goal")
TEXTS = ("", "world", "planar16/0", "map", "planar16/1", "\0", "ä" * 3, "w" * 5000, "tip_x", "\x1b[2J\n", "%s{}")
NUMBERS = (0.0, 0.4, -0.5, 1.0, 2.9, 1e308, -1e308, 5e-324, 1e6, math.nan, math.inf, -math.inf)
LENGTHS = (0, 1, 2, 255, 2**16, 2**20, 2**31 - 1, 2**31, 2**32 - 4, 2**32 - 1)
POOL = 40  # messages of each type that are changed
UUIDS = 200
JUNK = (
    None,
    True,
    -1,
    0,
    7,
    2**40,
    10**30,
    1e308,
    -1.5,
    "",
    "x" * 3000,
    "\x00\x1b",
    "ä",
    [],
    [None],
    {},
    {"a": 1},
    [[]],
)


class Input(NamedTuple):
    name: str
    payload: bytes
    attachment: bytes | None


class Inputs:
    def __init__(self, chance: random.Random) -> None:
        self.chance = chance
        self.uuids = [chance.randbytes(16) for _ in range(UUIDS)]
        self._pools = {
            name: [self._template(kind, kind_type) for _ in range(POOL)] for name, (kind, kind_type) in KINDS.items()
        }
        self._daemon = {key: json.dumps(value).encode() for key, value in payloads().items()}

    def message(self, now: float) -> Input:
        chance = self.chance
        name = NAMES[int(chance.random() * len(NAMES))]
        payload = bytearray(chance.choice(self._pools[name]))
        if name.endswith(("send_goal", "get_result", "cancel_goal")) and chance.random() < 0.9:
            payload[4:20] = chance.choice(self.uuids) if chance.random() < 0.7 else chance.randbytes(16)
        elif name in ("goal_pose", "goal_path", "setpoint") and chance.random() < 0.5:
            payload[4:12] = struct.pack("<iI", int(now) + chance.choice((0, 0, 2, -2, 6, -6, 400)), 500_000_000)
        kind = chance.random()
        if kind > 0.5:
            payload = self._mutated(payload) if kind < 0.98 else bytearray(self._random())
        return Input(name, bytes(payload), self._attachment())

    def token(self, tokens: Sequence[str]) -> str:
        """Returns a token of a stranger: much like one of `tokens`, or random text."""
        chance = self.chance
        if chance.random() < 0.05:
            return chance.choice(TEXTS)
        parts = chance.choice(tokens).split("/")
        parts[2] = chance.choice(("beef", "f00d", ""))
        if len(parts) > 11 and chance.random() < 0.7:
            parts[11] = chance.choice(("TypeHashNotSupported", "RIHS01_" + "0" * 64, *TEXTS))
            parts[5] = {"MS": "MP", "MP": "MS", "SS": "SC"}[parts[5]]
        if chance.random() < 0.3:
            parts[int(chance.random() * len(parts))] = chance.choice((*TEXTS, "99999999999", "::,,:"))
        return "/".join(parts)

    def daemon_message(self) -> tuple[str, bytes, bool]:
        """Returns key and payload of a message on the daemon's keys, and whether it may be the daemon's."""
        key, kind = self.chance.choice(tuple(self._daemon)), self.chance.random()
        data = self._daemon[key]
        if kind < 0.4:
            return key, data, True
        if kind < 0.8:
            return key, json.dumps(self.spoiled(json.loads(data))).encode("utf-8", "replace"), False
        return key, bytes(self._mutated(bytearray(data))) if kind < 0.95 else self._random(), False

    def spoiled(self, value: Any) -> Any:
        """Returns a JSON value with something in it replaced, removed or doubled."""
        chance = self.chance
        if isinstance(value, dict) and value and chance.random() < 0.95:
            key = chance.choice(tuple(value))
            if chance.random() < 0.1:
                del value[key]
            else:
                value[key] = self.spoiled(value[key]) if chance.random() < 0.6 else chance.choice(JUNK)
            return value
        if isinstance(value, list) and value and chance.random() < 0.9:
            k = int(chance.random() * len(value))
            if chance.random() < 0.2:
                return [*value[:k], *value[k + 1 :]]
            value[k] = self.spoiled(value[k])
            return value
        return chance.choice(JUNK)

    def _mutated(self, data: bytearray) -> bytearray:
        chance = self.chance
        for _ in range(chance.choice((1, 1, 1, 2, 4))):
            at = int(chance.random() * (len(data) + 1))
            match int(chance.random() * 7):
                case 0 if data:
                    data[at - 1] ^= 1 << int(chance.random() * 8)
                case 1:
                    del data[at:]
                case 2:
                    data[at:at] = chance.randbytes(int(chance.random() * 9))
                case 3:
                    at -= at % 4
                    data[at : at + 4] = struct.pack("<I", chance.choice(LENGTHS))
                case 4:
                    at += -at % 8 + 4  # numbers are aligned behind the header
                    data[at : at + 8] = struct.pack("<d", chance.choice(NUMBERS))
                case 5:
                    data[at:at] = data[at : at + 64]
                case _:
                    data[at : at + 1] = bytes([int(chance.random() * 256)])
        return data

    def _random(self) -> bytes:
        size = self.chance.choice((0, 1, 3, 4, 5, 40, 400)) if self.chance.random() < 0.995 else 1_000_001
        return self.chance.choice((HEADER, b"")) + self.chance.randbytes(size)

    def _attachment(self) -> bytes | None:
        good = struct.pack("<qqB", 1, 10**18, 16) + bytes(16)
        if (kind := self.chance.random()) < 0.95:
            return good
        return None if kind < 0.97 else bytes(self._mutated(bytearray(good)))

    def _template(self, kind: str, type_name: str) -> bytes:
        """Returns a message, which may break a rule of its content."""
        chance = self.chance
        if kind in ("goal_pose", "setpoint"):
            fields: dict[str, Any] = self._pose()
        elif kind == "goal_path":
            fields = {
                "header": self._header(),
                "poses": [self._pose(k) for k in range(chance.choice((0, 1, 2, 5, 50)))],
            }
        elif kind == "plan":
            fields = {"start": self._pose(), "goal": self._pose(), "tolerance": max(min(self._number(), 1e30), -1e30)}
        elif kind in ("tip", "actuators"):
            fields = {"goal": self._trajectory(kind)}
        elif kind == "cancel_goal":
            fields = {"goal_info": {"stamp": {"sec": chance.choice((0, 0, 1, 2**31 - 1, -1))}}}
        else:
            fields = {}
        return serialize(fields, type_name, TYPES)

    def _number(self) -> float:
        return self.chance.choice(NUMBERS) if self.chance.random() < 0.1 else self.chance.uniform(-3, 3)

    def _header(self, sec: int = 0) -> dict[str, Any]:
        frame = self.chance.choice(TEXTS) if self.chance.random() < 0.1 else self.chance.choice(TEXTS[:3])
        return {"frame_id": frame, "stamp": {"sec": sec}}

    def _pose(self, sec: int = 0) -> dict[str, Any]:
        orientation = dict(zip("xyzw", (0.0, 0.0, 0.6, 0.8), strict=True))
        if self.chance.random() < 0.1:
            orientation["w"] = self._number()
        return {
            "header": self._header(sec),
            "pose": {"position": {it: self._number() for it in "xyz"}, "orientation": orientation},
        }

    def _trajectory(self, kind: str) -> dict[str, Any]:
        chance = self.chance
        if kind == "tip":
            joints = chance.choice((["tip_x", "tip_y"], ["tip_y", "tip_x"], ["tip_x", "tip_y", "tip_yaw"]))
            values = self._number
        else:
            joints = chance.sample(chain().actuators, chance.choice((1, 5, 48)))
            values = lambda: float(int(chance.random() * 2))  # noqa: E731
        if chance.random() < 0.1:
            joints = chance.choice(
                (
                    [],
                    ["tip_x"],
                    ["tip_x", "tip_x"],
                    ["elbow"],
                    list(TEXTS),
                    [*joints, "elbow"],
                    ["w" * 100_000, *joints],
                )
            )
        rows = [[values() for _ in joints] for _ in range(chance.choice((0, 1, 1, 2, 20)))]
        if rows and chance.random() < 0.1:
            rows[-1] = [*rows[-1], 1.0]
        if rows and rows[-1] and chance.random() < 0.1:
            rows[-1][0] = self._number()
        points = [{"positions": row, "time_from_start": {"sec": k}} for k, row in enumerate(rows)]
        fields: dict[str, Any] = {"trajectory": {"header": self._header(), "joint_names": joints, "points": points}}
        if chance.random() < 0.2:
            fields["goal_tolerance"] = [{"name": chance.choice(("tip_x", *TEXTS)), "position": self._number()}]
        if chance.random() < 0.1:
            fields["path_tolerance"] = [{"name": chance.choice(("tip_x", *TEXTS)), "position": self._number()}]
        if chance.random() < 0.1:
            fields["goal_time_tolerance"] = {"sec": chance.choice((-5, -1, 0, 0, 1, 20)), "nanosec": 1}
        return fields


@functools.cache
def payloads() -> dict[str, dict[str, Any]]:
    fault = {"code": "board-lost", "source": "can0/5", "message": "board can0/5 is silent"}
    return {
        "arm": {**told(), "travel_time": 0.5},
        "state": state(faults=[fault], target={"position": [0.5, 2.8], "orientation": 0.1}, goal="ros2-" + "00" * 16),
        "result": {"id": "ros2-" + "00" * 16, "status": "succeeded", "code": 0, "message": "reached"},
        "feedback": {"id": "ros2-" + "00" * 16, "progress": 0.5},
        "diagnostics": {
            "buses": [
                {
                    **{"name": "can0", "state": "connected", "load": 0.1, "worst_case": {"load": 0.3}, "dropped": 0},
                    **{"tx_frames": 1, "rx_frames": 2, "tx_errors": 0, "rx_errors": 0},
                }
            ],
            "boards": [{"bus": "can0", "node": 5, "state": "lost", "emergency": None}],
            "loop": {"late_worst": 0.001},
            "executor": "connected",
        },
        "alive": {},
        "gone": {},
        "clearance": {},
    }
