"""The mechanics of a small planar arm by plain computation: tips of all configurations, and what serves a waypoint."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from hyperbit.controller.arm.arm import Arm
from hyperbit.controller.program import unpack
from tests.simulation.statements.asked import Payload, Request, measured_of
from tests.simulation.whole.configurations import Configurations, Disc

SLACK = 1e-9
NEAR = 1e-6  # of lengths and angles that are computed twice


class Tip(NamedTuple):
    """The tip of a configuration, in the world; `angle` is counter-clockwise [rad]."""

    notation: str
    position: tuple[float, float]
    angle: float

    def near(self, told: Payload) -> bool:
        """Returns whether position and orientation of a payload are those of the tip."""
        return math.dist(told["position"], self.position) + apart_of(told["orientation"], self.angle) < NEAR


class Mechanics:
    """All configurations of an arm.

    Attributes:
        tips: by code; a code has the actuator states as bits.
        codes: by notation.
        uniform: whether each switch costs 1.

    Args:
        space: lists the ways between configurations.
    """

    def __init__(self, arm: Arm, labels: tuple[str, ...], space: Configurations) -> None:
        self.labels, self.space = labels, space
        self.uniform = set(space.weights) == {1.0}
        self._tolerance, self._angle = arm.tolerance, arm.angle_tolerance
        named = zip(space.codes.tolist(), space.notations, space.tips.tolist(), space.angles.tolist(), strict=True)
        self.tips = {code: Tip(notation, (x, y), angle) for code, notation, (x, y), angle in named}
        self.codes = {tip.notation: code for code, tip in self.tips.items()}

    def code(self, known: bytes, measured: bytes) -> int:
        """Returns the code of measured states; -1 if one is not known."""
        states = measured_of(known, measured, len(self.labels))
        return -1 if None in states else unpack(measured)

    def place(self, waypoint: Payload) -> tuple[float, ...]:
        return tuple(waypoint.get("position") or self.tips[self.codes[waypoint["configuration"]]].position)

    def turned(self, request: Request, waypoint: Payload) -> float | None:
        """Returns the orientation that a waypoint asks for; None: any serves, also if the tolerance is half a turn."""
        return None if self._angle_of(request) >= math.pi else waypoint.get("orientation")

    def _angle_of(self, request: Request) -> float:
        return float((request.body.get("tolerance") or {}).get("orientation") or self._angle)

    def serving(self, request: Request, bias: list[float] | None) -> list[set[int]]:
        """Returns the codes that serve each waypoint of a goal."""
        asked = request.body.get("tolerance") or {}
        tolerance = min(float(asked.get("position") or self._tolerance), request.body.get("path_tolerance") or math.inf)

        def serves(waypoint: Payload, tip: Tip) -> bool:
            if "configuration" in waypoint:
                return bool(waypoint["configuration"] == tip.notation)
            apart = math.dist(shifted(tip.position, bias), waypoint["position"])
            turned = self.turned(request, waypoint)
            fits = turned is None or apart_of(tip.angle, turned) <= self._angle_of(request) + SLACK
            return apart <= tolerance + SLACK and fits

        return [{code for code, tip in self.tips.items() if serves(w, tip)} for w in request.body["waypoints"]]

    def least(
        self, start: int, locked: int, discs: frozenset[Disc], wanted: list[set[int]], between: bool = False
    ) -> float:
        """Returns the least cost from a state through a code of each set, in order; infinite if there is no way.

        `between`: also through states that are no configurations.
        """
        if start not in self.space.index:
            return math.inf
        graph = self.space.graph(locked, start, tuple(sorted(discs)), between)
        sets = [np.isin(self.space.codes, list(codes)) for codes in wanted]
        return self.space.optimum(graph, self.space.index[start], sets)

    def clear(self, start: int, locked: int, discs: frozenset[Disc]) -> set[int]:
        """Returns the codes that touch no obstacle, with the locked actuators as in a state."""
        permitted = self.space.graph(locked, start, tuple(sorted(discs))).permitted
        return set(self.space.codes[permitted].tolist())


def shifted(position: tuple[float, ...], bias: list[float] | None) -> tuple[float, ...]:
    return tuple(x + b for x, b in zip(position, bias or [0.0] * len(position), strict=True))


def apart_of(first: float, second: float) -> float:
    """Returns the angle between two orientations [rad]."""
    return abs(math.remainder(first - second, 2 * math.pi))
