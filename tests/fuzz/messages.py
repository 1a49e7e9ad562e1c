"""A valid message of each key."""

from tests.fuzz import requests
from tests.ros2.samples import state, told

FAULT = {"code": "board-lost", "source": "can0/5", "message": "board can0/5 is silent"}
STATE = {
    **state(faults=[FAULT], target={"position": [0.5, 2.8], "orientation": 0.1}, goal="a-1", waypoint=0),
    **{"progress": {"waypoints": 5, "reached": 2, "begins": 95.0, "ends": 103.2}, "bias": [0.0, 0.001]},
    **{"degraded": [{"actuator": "5.left", "state": 0}], "poses": 1},
}
DIAGNOSTICS = {
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
ANSWER = {"accepted": True, "code": 0, "message": "accepted", "id": "a-1"}
RESULT = {
    **{"id": "a-1", "status": "succeeded", "code": 0, "message": "reached", "switches": 3, "error": 0.001},
    **{"orientation_error": None, "position": [0.5, 2.8], "certificate": "optimal", "travels": [], "repeated": False},
}
FEEDBACK = {
    **{"id": "a-1", "waypoint": 0, "waypoints": 5, "configuration": "0" * 16, "error": 0.001},
    **{"orientation_error": None, "switches": 3},
}
POSE = {"name": "home", "goal": {"waypoints": [{"configuration": "0" * 16}]}}
OBSTACLES = requests.OBSTACLES["regions"]
ARM = {
    **told(),
    **{"limits": [], "sent_obstacles": OBSTACLES, "poses": [POSE], "daemon": {"host": "robot", "pid": 1}},
    **{"running": {"goal": "a-1", "waypoints": [[0.5, 2.8]]}, "file": {"name": "a.yaml", "text": "a: 1", "sha256": ""}},
}
PUBLISHED = {
    **{"state": STATE, "diagnostics": DIAGNOSTICS, "result": RESULT, "feedback": FEEDBACK, "arm": ARM},
    "request": {"stamp": 1.5e9, "key": "goal", "payload": requests.GOAL, "answer": ANSWER},
    "timeline": {"begin": 1.0, "end": 9.0, "at": 2.0, "speed": 1.0, "paused": False, "file": "a.mcap"},
}
