"""Waypoints as numbers: the rotation of an orientation; the tip and the actuator states of a configuration.

Functions import the kernels, which take a second to import. Clients that only decode messages need not wait for them.
"""

from __future__ import annotations

import json
import math
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from hyperbit.controller.armfile.strict import UNIT
from hyperbit.controller.refusals.reasons import Reason
from hyperbit.controller.refusals.refusal import Refusal

if TYPE_CHECKING:
    from hyperbit.controller.manipulator.manipulator import Manipulator

LONGEST = 200  # characters of a quoted message


def destination(
    text: str, manipulator: Manipulator | None, where: str
) -> tuple[NDArray[np.float64], NDArray[np.uint8]]:
    """Returns the tip's position (dimension,) and the actuator states (A,) of a configuration.

    Raises:
        Refusal: the text is no configuration of this arm.
    """
    from hyperbit.controller.manipulator.notation import parse_configuration

    if manipulator is None:
        raise Refusal(Reason.POSITIONS_ONLY, where=where)
    try:
        configuration = parse_configuration(manipulator, text)
    except ValueError as error:
        raise Refusal(Reason.NO_CONFIGURATION, where=where, error=str(error)[:LONGEST]) from None
    tip = manipulator.tip(configuration)
    return tip[: manipulator.dimension, 3], manipulator.actuator_states(configuration)


def rotation(orientation: float | list[float] | None, dimension: int, where: str) -> NDArray[np.float64]:
    """Returns the rotation (3, 3) of an orientation; the identity if it is absent.

    Raises:
        Refusal: a planar arm needs an angle, a spatial arm a unit quaternion.
    """
    from hyperbit.controller.manipulator import frames

    if orientation is None:
        return np.eye(3)
    if dimension == 2:
        if isinstance(orientation, list):
            raise Refusal(Reason.NO_ANGLE, where=where, count=len(orientation))
        return frames.planar(0.0, 0.0, orientation)[:3, :3]
    length = math.hypot(*orientation) if isinstance(orientation, list) and len(orientation) == 4 else 0.0
    if not isinstance(orientation, list) or abs(length - 1.0) > UNIT:
        got = f"one of length {length:.4g}" if length else f"{json.dumps(orientation)[:60]}"
        raise Refusal(Reason.NO_QUATERNION, where=where, got=got)
    return frames.spatial((0.0, 0.0, 0.0), orientation)[:3, :3]
