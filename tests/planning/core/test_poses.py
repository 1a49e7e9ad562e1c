"""Measured poses and targets."""

from __future__ import annotations

import numpy as np
import pytest

from controller.config import Arm
from controller.manipulator import frames
from controller.planning.core.poses import UNKNOWN, Target, measured_pose, measured_tip


@pytest.mark.parametrize("seed", range(5))
def test_the_angle_to_a_target(seed: int) -> None:
    rng = np.random.default_rng(seed)
    tip, target = (frames.spatial(rng.normal(size=3), rng.normal(size=4)) for _ in range(2))
    assert Target(target[:3, 3], 0.1, target[:3, :3]).angle(tip) == pytest.approx(frames.angle_between(tip, target))
    assert Target(target[:3, 3], 0.1).angle(tip) is None


def test_the_measured_pose_and_its_errors(small: Arm) -> None:
    manipulator = small.manipulator
    measured = manipulator.actuator_states([1, 2, 3, 4]).astype(np.int8)
    tip = manipulator.tip([1, 2, 3, 4])
    where = measured_pose(manipulator, measured, Target(tip[:2, 3] + [0.03, 0.04], 0.1))
    assert (where["configuration"], where["position"]) == ("1234", pytest.approx(tip[:2, 3]))
    assert (where["error"], where["orientation_error"]) == (pytest.approx(0.05), None)
    assert measured_pose(manipulator, measured, None)["error"] is None


def test_unknown_states_have_no_pose(small: Arm) -> None:
    measured = np.full(len(small.manipulator.actuators), -1, np.int8)
    assert measured_tip(small.manipulator, measured) is None
    assert measured_pose(small.manipulator, measured, None) == UNKNOWN
