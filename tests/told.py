"""One valid message of each key: what clients ask of a daemon, and what it tells of an arm."""

import functools
import json
from collections.abc import Sequence
from typing import Any

from msgspec import convert, to_builtins
from msgspec.structs import replace

from hyperbit.controller.arm.arm import Arm, load
from hyperbit.controller.arm.description import description, drawing, file
from hyperbit.controller.manipulator.notation import format_configuration, pose
from hyperbit.controller.messages.arm import Description
from hyperbit.controller.messages.state import State
from tests.keys import DEPLOY

Message = dict[str, Any]
NOW = 1_800_000_000.0  # [UNIX s], stamp of the requests
FAULT = {"code": "board-lost", "source": "can0/5", "message": "board can0/5 is silent"}

GOAL: Message = {
    "id": "a-1",
    "stamp": NOW + 1,
    "waypoints": [{"t": 0.0, "position": [0.55, 2.9]}, {"t": 0.5, "position": [0.5, 2.8]}],
    "tolerance": {"position": 0.002},
}
LINE: Message = {**GOAL, "path_tolerance": 0.01}
CONFIGURATIONS: Message = {"waypoints": [{"t": 0, "configuration": "071"}, {"t": 1, "configuration": "0,7,0"}]}
JOG: Message = {"actuators": {"1.left": "extended", "2.right": "contracted"}}
SETPOINT: Message = {"position": [0.55, 2.9, 0.1], "stamp": NOW, "tolerance": {"position": 0.002}}
DEGRADE: Message = {"actuator": "5.left", "state": 0}
MEASURED_TIP: Message = {"position": [0.55, 2.9], "stamp": NOW, "orientation": 0.1}
OBSTACLES: Message = {
    "regions": [
        {"disc": {"centre": [1.0, 2.0], "radius": 0.3}, "name": "pillar"},
        {"box": {"centre": [-1, 1], "size": [0.4, 0.2], "angle": 0.5}},
        {"half_plane": {"point": [0, -0.2], "normal": [0, 1]}, "name": "floor"},
    ]
}
OBSTACLES_IN_SPACE: Message = {
    "regions": [
        {"sphere": {"centre": [1.0, 2.0, 0.5], "radius": 0.3}},
        {"box": {"centre": [-1, 1, 2], "size": [0.4, 0.2, 1], "orientation": [0, 0.6, 0, 0.8]}},
        {"half_space": {"point": [0, 0, -0.2], "normal": [0, 0, 1]}},
    ]
}
POSE: Message = {"name": "home", "goal": {"waypoints": [{"configuration": "0" * 16}]}}

ANSWER: Message = {"accepted": True, "code": 0, "message": "accepted", "id": "a-1"}
RESULT: Message = {
    **{"id": "a-1", "status": "succeeded", "code": 0, "message": "reached", "switches": 3, "error": 0.001},
    **{"orientation_error": None, "position": [0.5, 2.8], "certificate": "optimal", "travels": [], "repeated": False},
}
FEEDBACK: Message = {
    **{"id": "a-1", "waypoint": 0, "waypoints": 5, "configuration": "0" * 16, "error": 0.001},
    **{"orientation_error": None, "switches": 3},
}
DIAGNOSTICS: Message = {
    "buses": [
        {
            **{"name": "can0", "state": "connected", "load": 0.1, "worst_case": {"load": 0.3}, "dropped": 0},
            **{"tx_frames": 1, "rx_frames": 2, "tx_errors": 0, "rx_errors": 0},
        }
    ],
    "boards": [{"bus": "can0", "node": 5, "state": "lost", "emergency": None, "heartbeat_age": 0.1}],
    "loop": {
        **{"late_p50": 1e-4, "late_p99": 1e-3, "late_worst": 0.001, "longest_period": 0.011},
        **{"mean_work": 1e-4, "longest_work": 2e-4, "overruns": 0.0},
    },
    **{"switches": 5, "ledger": "ok", "counts": [0] * 48, "queues": {"goals": 0}, "waits": 0, "executor": "connected"},
    "setpoint": {"received": 1, "refused": 0, "last_refusal": None},
}


@functools.cache
def arm(name: str = "planar16") -> Arm:
    return load(DEPLOY / f"{name}.yaml")


def described(which: str | Arm = "planar16", /, **fields: Any) -> Message:
    """Returns the answer to `arm` of an arm, or of one of deploy/."""
    return {**json.loads(_described(which) if isinstance(which, str) else _written(which)), **fields}


@functools.cache
def _described(name: str) -> str:
    return _written(arm(name))


def _written(whole: Arm) -> str:
    rest = {"limits": [], "sent_obstacles": [], "poses": [], "running": None, "daemon": {"host": "robot", "pid": 1}}
    return json.dumps(to_builtins(replace(description(whole), drawing=drawing(whole), file=file(whole))) | rest)


def state(which: str | Arm = "planar16", configuration: Sequence[int] = (), /, **fields: Any) -> Message:
    """Returns a `state` of an arm that is ready, by default contracted."""
    manipulator = (arm(which) if isinstance(which, str) else which).manipulator
    shown = [int(it) for it in configuration] or [0] * len(manipulator.modules)
    states = manipulator.actuator_states(shown).tolist()
    return {
        **{"stamp": 1.5e9, "mode": "ready", "reason": "holding", "simulated": True, "goal": None, "waypoint": None},
        **{"target": None, "commanded": states, "measured": states, "faults": [], "degraded": [], "obstacles": 0},
        **{"configuration": format_configuration(manipulator, shown), "tip": pose(manipulator, manipulator.tip(shown))},
        **fields,
    }


def read_state(*which: Any, **fields: Any) -> State:
    """Returns a `state` as its readers have it."""
    return convert(state(*which, **fields), State)


def read_arm(*which: Any, **fields: Any) -> Description:
    """Returns the answer to `arm` as its readers have it."""
    return convert(described(*which, **fields), Description)


@functools.cache
def published() -> dict[str, Message]:
    """Returns a message of each key that a daemon or a replay tells."""
    busy = {
        **{"faults": [FAULT], "target": {"position": [0.5, 2.8], "orientation": 0.1}, "goal": "a-1", "waypoint": 0},
        **{"progress": {"waypoints": 5, "reached": 2, "begins": 95.0, "ends": 103.2}, "bias": [0.0, 0.001]},
        **{"degraded": [{"actuator": "5.left", "state": 0}], "poses": 1},
    }
    running = {"goal": "a-1", "waypoints": [{"t": 0.0, "position": [0.5, 2.8], "orientation": None}]}
    return {
        **{"state": state(**busy), "diagnostics": DIAGNOSTICS, "result": RESULT, "feedback": FEEDBACK},
        "arm": described(sent_obstacles=OBSTACLES["regions"], poses=[POSE], running=running),
        "request": {"stamp": 1.5e9, "key": "goal", "payload": GOAL, "answer": ANSWER},
        "timeline": {"begin": 1.0, "end": 9.0, "at": 2.0, "speed": 1.0, "paused": False, "file": "a.mcap"},
    }
