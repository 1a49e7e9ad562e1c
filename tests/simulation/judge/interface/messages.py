"""The payloads of requests as the page describes them."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any

import msgspec

if TYPE_CHECKING:
    from tests.simulation.judge.interface.facts import Payload, Request
    from tests.simulation.judge.interface.modules import JudgedModules

GOAL = {"waypoints", "id", "stamp", "tolerance", "path_tolerance", "deadline", "begin_within"}
NAME = re.compile(r"[A-Za-z0-9_.-]([A-Za-z0-9_ .-]{0,38}[A-Za-z0-9_.-])?")  # of a pose
WAYPOINT = {"position", "orientation", "configuration", "t"}


def body_of(payload: bytes) -> Payload:
    """Returns a payload that is a JSON object; an empty one otherwise."""
    try:
        found = msgspec.json.decode(payload)
    except (msgspec.MsgspecError, UnicodeError, RecursionError):
        return {}
    return found if isinstance(found, dict) else {}


def well_formed(request: Request, modules: JudgedModules) -> bool:
    """Returns whether a payload has the form that the page asks for. `cancel`, and keys without a payload, take any."""
    body = request.body
    match request.key:
        case "goal" | "plan":
            return _is_goal(body, modules)
        case "jog":
            actuators = body.get("actuators")
            fits = isinstance(actuators, dict) and bool(actuators) and set(body) <= {"actuators", "begin_within"}
            return fits and all(
                label in modules.labels and state in ("contracted", "extended") for label, state in actuators.items()
            )
        case "degrade":
            return body.get("actuator") in modules.labels and body.get("state", "") in (None, 0, 1)
        case "obstacles":
            return isinstance(body.get("regions"), list)
        case "fault":
            return isinstance(body.get("fault"), str)
        case "result":
            return isinstance(body.get("id"), str)
        case "poses":
            return _is_pose(body, modules)
        case _:
            return True


def _is_goal(body: Payload, modules: JudgedModules) -> bool:
    waypoints: Any = body.get("waypoints")
    if not isinstance(waypoints, list) or not waypoints or not set(body) <= GOAL:
        return False
    for waypoint in waypoints:
        if not isinstance(waypoint, dict) or not set(waypoint) <= WAYPOINT:
            return False
        if ("position" in waypoint) == ("configuration" in waypoint):
            return False
        if "position" in waypoint and len(waypoint["position"]) != 2:
            return False
        if "configuration" in waypoint and waypoint["configuration"] not in modules.codes:
            return False
    return True


def _is_pose(body: Payload, modules: JudgedModules) -> bool:
    """Returns whether a payload is a pose to save, with a goal that has no id, or the name of one to remove."""
    name = body.get("save", body.get("remove"))
    if not isinstance(name, str) or not NAME.fullmatch(name):
        return False
    if "save" not in body:
        return set(body) == {"remove"}
    goal = body.get("goal")
    if set(body) != {"save", "goal"} or not isinstance(goal, dict) or {"id", "stamp"} & goal.keys():
        return False
    return goal.get("waypoints") == [] or _is_goal(goal, modules)  # without waypoints it is refused when it is sent
