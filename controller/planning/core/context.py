"""The context that goes with a program and comes back with its result: all that the result needs.

The planner that receives a result may be another process than the one that sent the program.
"""

from __future__ import annotations

import msgspec
import numpy as np

from controller.motion.feed import Proof
from controller.motion.targets import Target

MOST_BYTES = 8_192  # limit of the executor's contract


class Context(msgspec.Struct, frozen=True, omit_defaults=True):
    """What the result of a goal or jog needs.

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
        proof: switches, cost, bound and certificate of the plan; None for a jog.
        jogged: new state of each actuator of a jog, by index.
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
    proof: Proof | None = None
    jogged: dict[int, int] = {}

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


def with_target(context: Context, target: Target) -> Context:
    """Returns a context with the target of the last waypoint."""
    return msgspec.structs.replace(
        context,
        position=target.position.tolist(),
        tolerance=float(target.tolerance),
        rotation=[] if target.rotation is None else target.rotation.ravel().tolist(),
        angle_tolerance=float(target.angle_tolerance) if target.rotation is not None else 0.0,
        configuration=target.configuration,
    )


def encode_context(context: Context) -> bytes:
    """Returns a context as bytes; omits the configuration and the jogged actuators if it would be too long."""
    data = msgspec.msgpack.encode(context)
    if len(data) > MOST_BYTES:
        data = msgspec.msgpack.encode(msgspec.structs.replace(context, configuration=None, jogged={}))
    return data


def decode_context(data: bytes) -> Context | None:
    """Returns the context in a result; None if it cannot be decoded, as from another version of the planner."""
    try:
        return msgspec.msgpack.decode(data, type=Context)
    except (msgspec.DecodeError, RecursionError, UnicodeDecodeError):
        return None
