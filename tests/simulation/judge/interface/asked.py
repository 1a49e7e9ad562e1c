"""What a request asks for."""

from __future__ import annotations

import math
from collections.abc import Sequence

from hyperbit.controller.program import Stage
from tests.simulation.judge.interface.account import InterfaceAccount
from tests.simulation.judge.interface.facts import Payload, Request
from tests.simulation.judge.interface.messages import well_formed
from tests.simulation.judge.interface.modules import Cube, JudgedModules


def barring(request: Request) -> bool:
    """Returns whether a request bars earlier ones, of whatever id."""
    return request.key in ("stop", "reset") or (request.key == "cancel" and request.goal is None)


def patience(request: Request) -> float:
    """Returns the longest time to the begin of a goal or jog [s]."""
    own = request.body.get("begin_within")
    return float(own) if own is not None else 8.0 + float(request.body.get("deadline") or 0.0)


def lined(request: Request) -> bool:
    """Returns whether the tip shall follow straight lines."""
    return bool(request.body.get("path_tolerance"))


def posed(request: Request) -> bool:
    """Returns whether a waypoint is a configuration, or has an orientation."""
    return any("configuration" in waypoint or "orientation" in waypoint for waypoint in request.body["waypoints"])


def decodable(request: Request, modules: JudgedModules) -> bool:
    """Returns whether the gateway can decode a request; it also refuses configurations on straight lines."""
    if not well_formed(request, modules):
        return False
    return not lined(request) or not any("configuration" in waypoint for waypoint in request.body["waypoints"])


def ends_at(request: Request) -> float:
    """Returns the end of a trajectory with a stamp [UNIX s]."""
    return float(request.body.get("stamp", 0.0)) + max(float(w.get("t", 0.0)) for w in request.body["waypoints"])


def wanted(a: InterfaceAccount, request: Request) -> list[set[int]]:
    """Returns the codes that serve each waypoint."""
    asked, most = request.body.get("tolerance") or {}, float(request.body.get("path_tolerance") or math.inf)
    tolerance = min(float(asked.get("position") or a.tolerance), most)
    angle = float(asked.get("orientation") or a.angle_tolerance)

    def serving(waypoint: Payload) -> set[int]:
        if "configuration" in waypoint:
            return {a.modules.codes[waypoint["configuration"]]}
        bias = a.bias or (0.0, 0.0)
        near = a.modules.near(tuple(x - b for x, b in zip(waypoint["position"], bias, strict=True)), tolerance)
        turned = a.turned(request, waypoint)
        return near if turned is None else near & a.modules.turned(turned, angle)

    return [serving(waypoint) for waypoint in request.body["waypoints"]]


def places_of(stages: Sequence[Stage], request: Request) -> dict[int, int]:
    """Returns the mark of each waypoint, found by the times of the stages; the first point is the first waypoint."""
    settled = {stage.mark: stage.settled for stage in stages if stage.mark >= 0}
    times = [float(waypoint.get("t", 0.0)) for waypoint in request.body["waypoints"]]
    delay = settled.get(0, math.nan) - times[0]
    return {k: mark for k, t in enumerate(times) for mark, at in settled.items() if abs(at - delay - t) < 1e-6}


def cubes_of(request: Request) -> tuple[Cube, ...]:
    """Returns the obstacles of a request; the centre of each disc has mask and value."""
    centres = [region["disc"]["centre"] for region in request.body["regions"]]
    return tuple(Cube(round(mask), round(value)) for mask, value in centres)
