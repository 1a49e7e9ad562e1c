"""The measured pose of the arm, and targets to compare it with.

Measured actuator states have shape (A,), with 0 contracted, 1 extended, -1 unknown. Frames have shape (4, 4); lengths
are in the arm's unit, angles in radians.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from hyperbit.controller.manipulator.frames import angle_between
from hyperbit.controller.manipulator.notation import format_configuration, pose

if TYPE_CHECKING:
    from hyperbit.controller.manipulator.manipulator import Manipulator

Measured = NDArray[np.int8]
Pose = Mapping[str, Any]
Frame = NDArray[np.float64]

# The measured pose of an arm in no known configuration.
UNKNOWN: Pose = dict.fromkeys(("configuration", "position", "orientation", "error", "orientation_error"))


@dataclass(frozen=True, eq=False)
class GoalTarget:
    """The target at one point of a goal."""

    position: NDArray[np.float64]  # of the tip in the world, shape (dimension,)
    tolerance: float  # greatest distance from the position
    rotation: NDArray[np.float64] | None = None  # of the tip in the world, shape (3, 3); None: any orientation serves
    angle_tolerance: float = np.inf  # greatest angle from the rotation [rad]
    configuration: str | None = None  # that the arm must have, as text; None: any

    def angle(self, tip: Frame) -> float | None:
        """Returns the angle between a tip (4, 4) and the target [rad]; None if any orientation serves."""
        if self.rotation is None:
            return None
        return angle_between(tip, self.rotation)


def measured_tip(manipulator: Manipulator, measured: Measured) -> Frame | None:
    """Returns the tip's frame (4, 4) for measured actuator states (A,); None if they spell no configuration."""
    try:
        return np.asarray(manipulator.tips(manipulator.configuration(measured)[None])[0])
    except ValueError:
        return None


def measured_pose(manipulator: Manipulator, measured: Measured, target: GoalTarget | None) -> Pose:
    """Returns configuration and pose of measured actuator states (A,), and the errors from a target.

    All are None if the states spell no configuration; the errors are None without a target.
    """
    tip = measured_tip(manipulator, measured)
    if tip is None:
        return UNKNOWN
    error = None if target is None else float(np.linalg.norm(tip[: len(target.position), 3] - target.position))
    return {
        "configuration": format_configuration(manipulator, manipulator.configuration(measured)),
        **pose(manipulator, tip),
        "error": error,
        "orientation_error": None if target is None else target.angle(tip),
    }
