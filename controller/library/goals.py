"""Goals: positions and poses of the tip in the world."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from hyperbit.controller.armfile.choices import LARGEST, LARGEST_ANGLE, degrees_hint
from hyperbit.controller.armfile.goal_files import read_goal
from hyperbit.controller.armfile.strict import UNIT, InputFaults
from hyperbit.controller.library.arguments import Number, Numbers, typed
from hyperbit.controller.library.errors import GoalError
from hyperbit.controller.manipulator import frames
from hyperbit.controller.motion.decoding.goal import parse
from hyperbit.controller.refusals.refusal import Refusal, nth_waypoint

Array = NDArray[np.float64]


@typed(GoalError)
@dataclass(frozen=True, eq=False)
class Goal:
    """A position of the tip, optionally with an orientation.

    Attributes:
        position: in the world, shape (2,) for planar arms, (3,) for spatial arms, in the arm's unit of length.
        orientation: for planar arms an angle, counter-clockwise [rad]; for spatial arms a unit quaternion x, y, z, w,
            shape (4,); None: any orientation.
        tolerance: greatest distance of the tip from `position`; None: the arm's tolerance.
        angle_tolerance: greatest angle of the tip from `orientation` [rad]; None: the arm's tolerance.

    Raises:
        GoalError: a number is not finite, a tolerance is not positive, or the shapes do not match.
    """

    position: Numbers
    orientation: Numbers | None = None
    tolerance: Number | None = None
    angle_tolerance: Number | None = None

    def __post_init__(self) -> None:
        """Checks the numbers, and keeps read-only copies of arrays."""
        position = copied(self.position)
        object.__setattr__(self, "position", position)
        if position.shape not in ((2,), (3,)):
            raise GoalError(f"position: shape (2,) or (3,) is needed, got shape {position.shape}")
        if self.orientation is not None:
            orientation = copied(self.orientation)
            if orientation.shape != (() if position.shape == (2,) else (4,)):
                form = "an angle [rad]" if position.shape == (2,) else "a quaternion x, y, z, w of shape (4,)"
                raise GoalError(f"orientation: with this position it is {form}, got shape {orientation.shape}")
            object.__setattr__(self, "orientation", float(orientation) if orientation.ndim == 0 else orientation)
            if orientation.ndim == 0 and abs(orientation) > LARGEST_ANGLE:
                words = f"a number from -{LARGEST_ANGLE} to {LARGEST_ANGLE} is needed, got {float(orientation):g}"
                raise GoalError(f"orientation: {words}{degrees_hint(float(orientation))}")
            if orientation.shape == (4,) and abs(float(np.linalg.norm(orientation)) - 1.0) > UNIT:
                raise GoalError(f"orientation: a quaternion of length 1 is needed, got {orientation.tolist()}")
        for name, most in (("tolerance", LARGEST), ("angle_tolerance", LARGEST_ANGLE)):
            value = getattr(self, name)
            if value is not None and not 1e-9 <= value <= most:
                raise GoalError(f"{name}: a number from 1e-9 to {most:g} is needed, got {value!r}")
            object.__setattr__(self, name, None if value is None else float(value))
        if self.angle_tolerance is not None and self.orientation is None:
            raise GoalError("angle_tolerance: the goal has no orientation")

    @property
    def target(self) -> Array:
        """The position, shape (2,) or (3,); with an orientation, the frame, shape (4, 4)."""
        position = np.asarray(self.position, dtype=float)
        if self.orientation is None:
            return position
        if len(position) == 2:
            return frames.planar(float(position[0]), float(position[1]), float(np.asarray(self.orientation)))
        return frames.spatial(position, np.asarray(self.orientation))


GoalLike: TypeAlias = "Goal | Numbers"
Goals: TypeAlias = "Sequence[GoalLike] | NDArray[Any]"


@typed(GoalError)
def read_goals(file: str | Path) -> list[Goal]:
    """Returns the goals of a file that `hyperbit send` takes: CSV, JSON or YAML. Its times do not matter here.

    Raises:
        GoalError: the file cannot be read, or a waypoint is a configuration. The message has the line or the waypoint.
    """
    try:
        message = parse(json.dumps(read_goal(Path(file))).encode())
    except InputFaults as error:
        raise GoalError(str(error)) from None
    except Refusal as error:
        raise GoalError(f"{file}: {error}") from None
    goals, tolerance = list[Goal](), message.tolerance
    for k, waypoint in enumerate(message.waypoints):
        if waypoint.position is None:
            raise GoalError(f"{file}: {nth_waypoint(k)}: a configuration is no goal of the library; give its position")
        turn = None if waypoint.orientation is None else tolerance.orientation
        goals.append(Goal(waypoint.position, waypoint.orientation, tolerance.position, turn))
    return goals


def copied(values: Numbers) -> Array:
    """Returns values as a read-only array of floats, which the caller does not share."""
    result = np.array(values, dtype=float)
    result.flags.writeable = False
    return result


@dataclass(frozen=True, eq=False)
class ToleratedGoal:
    """A goal with its effective tolerances.

    Attributes:
        goal: the goal.
        target: see Goal.target.
        tolerance: position tolerance.
        angle_tolerance: orientation tolerance [rad]; infinite without an orientation.
    """

    goal: Goal
    target: Array
    tolerance: float
    angle_tolerance: float


def with_tolerances(goal: GoalLike, dimension: int, tolerance: float, angle_tolerance: float) -> ToleratedGoal:
    """Returns a goal, or a bare position, with the arm's tolerances as defaults.

    Raises:
        GoalError: the goal has another dimension than the arm.
    """
    own = goal if isinstance(goal, Goal) else Goal(goal)
    size = len(np.asarray(own.position))
    if size != dimension:
        raise GoalError(f"a goal of this arm has {dimension} coordinates, got {size}")
    angle = math.inf if own.orientation is None else float(own.angle_tolerance or angle_tolerance)
    return ToleratedGoal(own, own.target, float(own.tolerance or tolerance), angle)


def all_with_tolerances(
    goals: Goals, dimension: int, tolerance: float, angle_tolerance: float, name: str = "goals"
) -> list[ToleratedGoal]:
    """Returns goals, see with_tolerances.

    Raises:
        GoalError: see with_tolerances; the message has the argument's name and the index of the goal.
    """
    result = list[ToleratedGoal]()
    for k, goal in enumerate(goals):
        try:
            result.append(with_tolerances(goal, dimension, tolerance, angle_tolerance))
        except GoalError as error:
            raise GoalError(f"{name}[{k}]: {error}") from None
    return result
