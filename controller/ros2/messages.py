"""Messages of the daemon as messages of ROS 2."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

from msgspec import to_builtins

from hyperbit.controller.messages.state import Diagnostics, State
from hyperbit.controller.pictures.scene import FoxgloveScene, shown_of
from hyperbit.controller.ros2.poses import Fields, Place, time_of

DEBUG, INFO, WARN, ERROR = 10, 20, 30, 40  # of rcl_interfaces/msg/Log
OK, WARNING, FAULTY, STALE = range(4)  # of diagnostic_msgs/msg/DiagnosticStatus
LEVELS = {"ready": OK, "executing": OK, "starting": WARNING, "stopped": WARNING, "fault": FAULTY}
LINE_LIST, DELETE = 5, 2  # of visualization_msgs/msg/Marker
SOLIDS = {"cubes": 1, "spheres": 2, "cylinders": 3}
THIN = 1 / 300  # of the arm's length: width of a line


def header(stamp: float, frame: str = "") -> Fields:
    """Returns a std_msgs/msg/Header of a UNIX time [s]."""
    return {"stamp": time_of(stamp), "frame_id": frame}


def joint_state(state: State, labels: Sequence[str]) -> Fields:
    """Returns the sensor_msgs/msg/JointState of a `state`: 0 contracted, 1 extended, NaN unknown."""
    measured = state.measured or [None] * len(labels)
    positions = [math.nan if value is None else float(value) for value in measured]
    return {"header": header(state.stamp), "name": list(labels), "position": positions}


def tip_pose(state: State, place: Place) -> Fields | None:
    """Returns the geometry_msgs/msg/PoseStamped of the measured tip; None if it is not known."""
    if state.tip is None:
        return None
    return {"header": header(state.stamp, place.world), "pose": place.pose(state.tip)}


def transforms(scene: FoxgloveScene, state: State, world: str) -> list[Fields]:
    """Returns the geometry_msgs/msg/TransformStamped of the base, then of each module, base first."""
    return [
        {
            "header": header(state.stamp, world if it["parent_frame_id"] == "world" else it["parent_frame_id"]),
            "child_frame_id": it["child_frame_id"],
            "transform": {"translation": it["translation"], "rotation": it["rotation"]},
        }
        for it in scene.transforms(shown_of(state), state.stamp)["transforms"]
    ]


class Markers:
    """The markers of an arm of some length, its goal and its obstacles, in the frame `world` [m]."""

    def __init__(self, scene: FoxgloveScene, arm: str, length: float, world: str) -> None:
        self.scene, self._arm, self._width, self._world = scene, arm, length * THIN, world
        self._shown: set[tuple[str, int]] = set()

    def array(self, state: State) -> Fields:
        """Returns the visualization_msgs/msg/MarkerArray of a `state`, with DELETE for each marker that is gone."""
        markers: list[Fields] = []
        for entity in self.scene.update(shown_of(state), state.stamp)["entities"]:
            frame = self._world if entity["frame_id"] == "world" else entity["frame_id"]
            head = {
                "header": header(state.stamp, frame),
                "ns": f"{self._arm} {entity['id']}",
                "frame_locked": True,
            }
            for line in entity["lines"]:
                shape = {"type": LINE_LIST, "points": line["points"], "scale": {"x": self._width}, "pose": line["pose"]}
                markers.append({**head, **shape, "color": line["color"]})
            for kind, number in SOLIDS.items():
                for solid in entity[kind]:
                    shape = {"type": number, "pose": solid["pose"], "scale": solid["size"], "color": solid["color"]}
                    markers.append({**head, **shape})
        counts: dict[str, int] = {}
        for marker in markers:
            marker["id"] = counts[marker["ns"]] = counts.get(marker["ns"], -1) + 1
        shown = {(marker["ns"], marker["id"]) for marker in markers}
        gone = [{"ns": ns, "id": k, "action": DELETE} for ns, k in sorted(self._shown - shown)]
        self._shown = shown
        return {"markers": [*gone, *markers]}


def diagnostics(arm: str, state: State, told: Diagnostics | None, *, alive: bool = True) -> Fields:
    """Returns the diagnostic_msgs/msg/DiagnosticArray of an arm.

    `told` is the latest `diagnostics`. The latest messages are stale unless the daemon is `alive`.
    """
    words, level = f"{state.mode}: {state.reason}", LEVELS.get(state.mode, STALE)
    entries = [
        status(
            f"{arm}: arm",
            level if alive else STALE,
            words if alive else f"the daemon is gone; its last words were {words}",
            {
                "goal": state.goal or "",
                "simulated": state.simulated,
                "homing": ", ".join(state.homing),
            },
        )
    ]
    for fault in state.faults:
        level = FAULTY if state.mode == "fault" else WARNING
        entries.append(status(f"{arm}: {fault.source}: {fault.code}", level, fault.message, {}))
    if told is not None:
        for bus in told.buses:
            level = OK if bus.state in ("connected", "active") else FAULTY
            entries.append(status(f"{arm}: bus {bus.name}", level, bus.state, to_builtins(bus)))
        for board in told.boards:
            level = OK if board.state == "operational" else FAULTY
            entries.append(status(f"{arm}: board {board.bus}/{board.node}", level, board.state, to_builtins(board)))
        others = {name: getattr(told, name) for name in ("real_time", "ledger", "executor", "dropped")}
        entries.append(status(f"{arm}: loop", OK, told.executor, {**to_builtins(told.loop), **others}))
    return {"header": header(state.stamp), "status": entries}


def status(name: str, level: int, message: str, values: Mapping[str, Any]) -> Fields:
    pairs = [{"key": str(key), "value": str(value)} for key, value in values.items() if key not in ("name", "state")]
    return {"level": level, "name": name, "message": message, "hardware_id": name.partition(":")[0], "values": pairs}


def log(stamp: float, level: int, node: str, text: str) -> Fields:
    """Returns a rcl_interfaces/msg/Log of a UNIX time [s]."""
    return {"stamp": time_of(stamp), "level": level, "name": node, "msg": text, "file": "", "function": "", "line": 0}
