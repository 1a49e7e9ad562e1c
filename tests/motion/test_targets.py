"""Measured poses and targets."""

from __future__ import annotations

import numpy as np
import pytest

from hyperbit.controller.manipulator import frames
from hyperbit.controller.manipulator.manipulator import Manipulator
from hyperbit.controller.manipulator.notation import format_configuration
from hyperbit.controller.motion.targets import UNKNOWN, GoalTarget, measured_pose, measured_tip


@pytest.mark.parametrize("seed", range(5))
def test_the_angle_to_a_target(seed: int) -> None:
    rng = np.random.default_rng(seed)
    tip, target = (frames.spatial(rng.normal(size=3), rng.normal(size=4)) for _ in range(2))
    assert GoalTarget(target[:3, 3], 0.1, target[:3, :3]).angle(tip) == pytest.approx(frames.angle_between(tip, target))
    assert GoalTarget(target[:3, 3], 0.1).angle(tip) is None


def test_the_measured_pose_and_its_errors(manipulator: Manipulator) -> None:
    configuration, dimension = np.arange(len(manipulator.modules)) % 4, manipulator.dimension
    measured, tip = manipulator.actuator_states(configuration).astype(np.int8), manipulator.tip(configuration)
    away = np.array([0.03, 0.04, 0.0][:dimension])
    where = measured_pose(manipulator, measured, GoalTarget(tip[:dimension, 3] + away, 0.1))
    assert where["configuration"] == format_configuration(manipulator, configuration)
    assert where["position"] == pytest.approx(tip[:dimension, 3])
    assert (where["error"], where["orientation_error"]) == (pytest.approx(0.05), None)
    assert measured_pose(manipulator, measured, None)["error"] is None


def test_unknown_states_have_no_pose(manipulator: Manipulator) -> None:
    measured = np.full(len(manipulator.actuators), -1, np.int8)
    assert measured_tip(manipulator, measured) is None
    assert measured_pose(manipulator, measured, None) == UNKNOWN
