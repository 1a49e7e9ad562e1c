"""The context that goes with a program and comes back with its result, for a planner that was restarted meanwhile."""

import time

import msgspec
import numpy as np
from numpy.typing import NDArray

from controller.planning.goal_check import Target

MOST_BYTES = 8_192  # limit of the executor's contract


class GoalContext(msgspec.Struct, frozen=True, omit_defaults=True):
    """What the result of a goal needs.

    Attributes:
        id: of the goal.
        waypoints: number of waypoints.
        last_mark: mark of the last waypoint.
        position: of the last waypoint, `dimension` coordinates; empty for a jog, which has no target.
        tolerance: of the position.
        rotation: nine numbers, row by row; empty: any orientation serves.
        angle_tolerance: [rad].
        configuration: in which the arm must end, as text; None: any.
        bias: tip bias by which the goal was corrected; None: no tracker.
        sent: time at which the program was made [UNIX s].
    """

    id: str
    waypoints: int = 1
    last_mark: int = 0
    position: list[float] = []
    tolerance: float = 0.0
    rotation: list[float] = []
    angle_tolerance: float = 0.0
    configuration: str | None = None
    bias: list[float] | None = None
    sent: float = 0.0

    @property
    def target(self) -> Target | None:
        """The last waypoint; None for a jog."""
        if not self.position:
            return None
        turned = bool(self.rotation)
        return Target(
            np.array(self.position),
            self.tolerance,
            np.array(self.rotation).reshape(3, 3) if turned else None,
            self.angle_tolerance if turned else np.inf,
            self.configuration,
        )


def encode_context(
    goal: str, waypoints: int, last_mark: int, target: Target | None, bias: NDArray[np.float64] | None
) -> bytes:
    """Returns the context of a program; it omits the configuration if the context would be too long."""
    context = GoalContext(goal, waypoints, last_mark, bias=None if bias is None else bias.tolist(), sent=time.time())
    if target is not None:
        context = msgspec.structs.replace(
            context,
            position=target.position.tolist(),
            tolerance=target.tolerance,
            rotation=[] if target.rotation is None else target.rotation.ravel().tolist(),
            angle_tolerance=target.angle_tolerance if target.rotation is not None else 0.0,
            configuration=target.configuration,
        )
    data = msgspec.msgpack.encode(context)
    if len(data) > MOST_BYTES:
        data = msgspec.msgpack.encode(msgspec.structs.replace(context, configuration=None))
    return data


def decode_context(data: bytes) -> GoalContext | None:
    """Returns the context in a result; None if it cannot be decoded, as from another version of the planner."""
    try:
        return msgspec.msgpack.decode(data, type=GoalContext)
    except (msgspec.DecodeError, RecursionError, UnicodeDecodeError):
        return None
