"""Decodes the payloads of requests. Nothing else decodes them."""

import json
import math

import msgspec

from controller.config import Arm
from controller.motion.codes import GOAL_TOLERANCE_VIOLATED, Refusal
from controller.motion.goal import GoalMessage, Id, parse
from controller.motion.requests import decode_degrade, decode_jog, decode_obstacles
from controller.planning.core.events import CancelMessage, Key, LockMessage, Message, ObstaclesMessage


class _NamedGoal(msgspec.Struct):
    """The payload of a `cancel` of one goal; other fields are ignored."""

    id: Id


class RequestDecoder:
    """Decodes requests. For any thread.

    Args:
        arm: that the requests are for.
    """

    def __init__(self, arm: Arm) -> None:
        manipulator, tracker = arm.manipulator, arm.settings.tracker
        self._actuators, self._dimension = manipulator.actuators, manipulator.dimension
        self._base = manipulator.base[: manipulator.dimension, 3].tolist()
        self._farthest = manipulator.length + (tracker.clamp if tracker else 0.0)  # of a tip from the base
        self._tolerance = arm.tolerance

    def decode(self, key: Key, payload: bytes) -> Message:
        """Returns the content of a request, in microseconds; None for keys without a content.

        Args:
            key: of the interface.
            payload: as it came, any bytes.

        Raises:
            Refusal: the payload is invalid; the message names the field. No other exception is raised.
        """
        match key:
            case "goal" | "plan":
                return self._goal(payload)
            case "jog":
                return decode_jog(payload, self._actuators)
            case "cancel":
                return decode_cancel(payload)
            case "degrade":
                lock = decode_degrade(payload)
                return LockMessage(lock.actuator, lock.state)
            case "obstacles":
                obstacles = decode_obstacles(payload, self._dimension)
                return ObstaclesMessage(obstacles, json.loads(payload)["regions"])
            case "stop" | "reset" | "arm":
                return None

    def _goal(self, payload: bytes) -> GoalMessage:
        """Returns a goal; positions beyond the arm's length are refused here, without a search."""
        message = parse(payload)
        farthest = self._farthest + (message.tolerance.position or self._tolerance)
        for k, waypoint in enumerate(message.waypoints):
            position = waypoint.position
            if position is None or len(position) != self._dimension:
                continue
            away = math.dist(position, self._base)
            if away > farthest:
                where = f"waypoints[{k}].position: ({', '.join(f'{x:g}' for x in position)}) is out of reach"
                words = f"{where}: {away:g} from the base, and no tip is farther from it than {self._farthest:g}"
                raise Refusal(GOAL_TOLERANCE_VIOLATED, words, message.id)
        return message


def decode_cancel(payload: bytes) -> CancelMessage:
    """Returns the content of a `cancel`: the goal that {"id": ...} names.

    Any other payload cancels whatever runs, because a cancel must not fail for its form.
    """
    try:
        return CancelMessage(msgspec.json.decode(payload, type=_NamedGoal).id)
    except (msgspec.MsgspecError, RecursionError, UnicodeError):
        return CancelMessage()
