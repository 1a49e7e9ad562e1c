"""Poses of ROS 2 as waypoints: frames, stamps and turns; and back."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hyperbit.controller.manipulator.frames import quaternion
from hyperbit.controller.ros2 import poses
from hyperbit.controller.ros2.poses import BadGoal, check_stamp, pose, rotation, waypoint, yaw
from tests.ros2.samples import place, pose_stamped

ANGLES = st.floats(-3.1, 3.1)
UNIT = st.lists(st.floats(-1, 1), min_size=4, max_size=4).filter(lambda q: np.linalg.norm(q) > 0.1)


def test_a_position_in_the_world_or_in_the_frame_of_the_base() -> None:
    base = np.array([[0.0, -1, 0, 2], [1, 0, 0, 1], [0, 0, 1, 0], [0, 0, 0, 1]])
    for frame in ("", "world"):
        it = waypoint(pose_stamped(0.5, 2.8, frame_id=frame), place(base), "goal_pose", oriented=False)
        assert it == {"position": [0.5, 2.8]}
    it = waypoint(pose_stamped(0.5, 0.25, frame_id="planar16/0"), place(base), "goal_pose", oriented=True)
    assert it["position"] == pytest.approx([1.75, 1.5])
    assert it["orientation"] == pytest.approx(math.pi / 2)


@pytest.mark.parametrize("w", [0.0, math.nan, 2.0])
def test_a_turn_needs_a_unit_quaternion(w: float) -> None:
    message = pose_stamped(0.5, 2.8)
    message.pose.orientation.w = w
    assert waypoint(message, place(), "goal_pose", oriented=False) == {"position": [0.5, 2.8]}
    with pytest.raises(BadGoal, match="orientation"):
        waypoint(message, place(), "goal_pose", oriented=True)


def test_stamps_that_are_old_or_in_the_future_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(poses, "time", SimpleNamespace(time=lambda: 1e9))
    for good in (0.0, 1e9, 1e9 - poses.OLDEST, 1e9 + poses.OLDEST):
        check_stamp(good, "goal_pose")
    with pytest.raises(BadGoal, match=r"goal_pose.header.stamp: 6.0 s old, expected at most 5 s, or 0") as refused:
        check_stamp(1e9 - 6, "goal_pose")
    assert refused.value.code == -3
    with pytest.raises(BadGoal, match=r"6.0 s in the future"):
        check_stamp(1e9 + 6, "goal_pose")


@given(ANGLES)
def test_an_angle_in_the_plane_comes_back(angle: float) -> None:
    told = {"position": [1.0, 2.0], "orientation": angle}
    there = pose(told)
    turned = rotation([there["orientation"][name] for name in "xyzw"], "")
    assert poses.orientation(turned, 2) == pytest.approx(angle)
    assert yaw(told) == pytest.approx(angle)


@given(UNIT)
def test_a_rotation_is_that_of_the_quaternion(given: list[float]) -> None:
    unit = np.array(given) / np.linalg.norm(given)
    turned = np.eye(4)
    turned[:3, :3] = rotation(unit.tolist(), "")
    assert np.abs(quaternion(turned) @ unit) == pytest.approx(1.0, abs=1e-6)
    told = {"position": [0, 0, 0], "orientation": unit.tolist()}
    level = math.hypot(turned[0, 0], turned[1, 0])
    if level > 0.01:
        assert math.cos(yaw(told)) == pytest.approx(turned[0, 0] / level, abs=1e-6)
