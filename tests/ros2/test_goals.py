"""Poses and trajectories of ROS 2 as goals of the daemon: frames, stamps, turns; what is refused, with which code."""

import json
import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hyperbit.controller.manipulator.frames import Frame, quaternion
from hyperbit.controller.manipulator.notation import parse_configuration
from hyperbit.controller.messages.parts import Pose
from hyperbit.controller.motion.decoding.goal import parse
from hyperbit.controller.ros2 import poses
from hyperbit.controller.ros2.poses import BadGoal, Place, check_stamp, rotation, waypoint, yaw
from hyperbit.controller.ros2.trajectories import actuator_goal, time_tolerance, tip_goal, tip_positions
from hyperbit.controller.ros2.wire.cdr import message
from tests import told
from tests.ros2.rig import pose_stamped, trajectory_goal
from tests.ros2.world.inputs import TYPES

ANGLES = st.floats(-3.1, 3.1)
UNIT = st.lists(st.floats(-1, 1), min_size=4, max_size=4).filter(lambda q: np.linalg.norm(q) > 0.1)
PAPER = told.arm().manipulator
CONTRACTED = told.state()["measured"]
PLANE = ["tip_x", "tip_y"]


def place(base: Frame | None = None, dimension: int = 2) -> Place:
    return Place("world", "planar16", np.eye(4) if base is None else base, dimension)


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


def test_stamps_that_are_old_or_in_the_future_are_refused() -> None:
    for good in (0.0, 1e9, 1e9 - poses.OLDEST, 1e9 + poses.OLDEST):
        check_stamp(good, "goal_pose", 1e9)
    with pytest.raises(BadGoal, match=r"goal_pose.header.stamp: 6.0 s old, expected at most 5 s, or 0") as refused:
        check_stamp(1e9 - 6, "goal_pose", 1e9)
    assert refused.value.code == -3
    with pytest.raises(BadGoal, match=r"6.0 s in the future"):
        check_stamp(1e9 + 6, "goal_pose", 1e9)


def test_numbers_that_overflow_are_refused() -> None:
    with pytest.raises(BadGoal, match=r"goal_pose: 1e\+308, expected at most 1e\+06"):
        waypoint(pose_stamped(1e308, 1e308), place(), "goal_pose", oriented=False)


@given(ANGLES)
def test_an_angle_in_the_plane_comes_back(angle: float) -> None:
    told = Pose([1.0, 2.0], angle)
    there = place().pose(told)
    turned = rotation([there["orientation"][name] for name in "xyzw"], "")
    assert poses.orientation(turned, 2) == pytest.approx(angle)
    assert yaw(told) == pytest.approx(angle)


@given(UNIT)
def test_a_rotation_is_that_of_the_quaternion(given: list[float]) -> None:
    unit = np.array(given) / np.linalg.norm(given)
    turned = np.eye(4)
    turned[:3, :3] = rotation(unit.tolist(), "")
    assert np.abs(quaternion(turned) @ unit) == pytest.approx(1.0, abs=1e-6)
    told = Pose([0, 0, 0], unit.tolist())
    level = math.hypot(turned[0, 0], turned[1, 0])
    if level > 0.01:
        assert math.cos(yaw(told)) == pytest.approx(turned[0, 0] / level, abs=1e-6)


def test_a_trajectory_of_the_tip_is_a_goal_of_the_daemon() -> None:
    goal = trajectory_goal(
        ["tip_y", "tip_x", "tip_yaw"],
        [[2.9, 0.5, 0.1], [2.8, 0.4, 0.2]],
        trajectory={"header": {"stamp": {"sec": 1_700_000_000, "nanosec": 500_000_000}}},
        goal_tolerance=[{"name": "tip_x", "position": 0.02}, {"name": "tip_y", "position": 0.01}],
        path_tolerance=[{"name": "tip_x", "position": 0.3}],
    )
    found = tip_goal(goal, place())
    assert found["stamp"] == pytest.approx(1_700_000_000.5)
    assert [it["position"] for it in found["waypoints"]] == [[0.5, 2.9], [0.4, 2.8]]
    assert [it["orientation"] for it in found["waypoints"]] == [pytest.approx(0.1), pytest.approx(0.2)]
    assert [it["t"] for it in found["waypoints"]] == [0.0, 1.0]
    assert (found["tolerance"], found["path_tolerance"]) == ({"position": 0.01}, 0.3)
    assert parse(json.dumps(found).encode()).waypoints[1].position == [0.4, 2.8]


def test_an_erased_tolerance_is_none() -> None:
    erased = [{"name": name, "position": -1.0} for name in ("tip_x", "tip_y", "tip_yaw")]
    goal = trajectory_goal(["tip_x", "tip_y"], [[0.5, 2.9]], goal_tolerance=erased, path_tolerance=erased)
    found = tip_goal(goal, place())
    assert (found["tolerance"], "path_tolerance" in found) == ({"orientation": math.pi}, False)


def test_an_angle_in_the_frame_of_a_tilted_base_is_that_of_the_same_pose() -> None:
    base = np.eye(4)
    base[:3, :3] = [[1, 0, 0], [0, 0, -1], [0, 1, 0]]  # turned by 90 degrees about x: an arm on a wall
    wall, yaw = Place("world", "wall", base, 3), 0.6
    header = {"header": {"frame_id": "wall/0"}}
    names = ["tip_x", "tip_y", "tip_z", "tip_yaw"]
    (point,) = tip_goal(trajectory_goal(names, [[0.1, 0.2, 0.3, yaw]], trajectory=header), wall)["waypoints"]
    turned = {
        "position": {"x": 0.1, "y": 0.2, "z": 0.3},
        "orientation": {"z": math.sin(yaw / 2), "w": math.cos(yaw / 2)},
    }
    pose = message({**header, "pose": turned}, "geometry_msgs/msg/PoseStamped", TYPES)
    same = waypoint(pose, wall, "goal_pose", oriented=True)
    assert point["position"] == pytest.approx(same["position"])
    assert point["orientation"] == pytest.approx(same["orientation"])


def test_a_negative_time_tolerance_is_refused() -> None:
    goal = trajectory_goal(["tip_x", "tip_y"], [[0.5, 2.9]], goal_time_tolerance={"sec": -2})
    with pytest.raises(BadGoal, match="goal_time_tolerance: -2 s is negative; 0 and -1 mean"):
        time_tolerance(goal)


def test_an_angle_in_space_is_about_z() -> None:
    goal = trajectory_goal(["tip_x", "tip_y", "tip_z", "tip_yaw"], [[0.1, 0.2, 0.3, math.pi / 2]])
    (point,) = tip_goal(goal, place(dimension=3))["waypoints"]
    assert point["orientation"] == pytest.approx([0, 0, math.sqrt(0.5), math.sqrt(0.5)])


def tolerance(kind: str, joint: str, position: float) -> dict[str, Any]:
    return {f"{kind}_tolerance": [{"name": joint, "position": position}]}


@pytest.mark.parametrize(
    ("joints", "rows", "fields", "code", "sentence"),
    [
        (["tip_x"], [[0.5]], {}, -2, "tip_x, expected tip_x, tip_y, and perhaps tip_yaw"),
        ([*PLANE, "tip_z"], [[1, 2, 3]], {}, -2, "expected tip_x, tip_y"),
        (["tip_x", "tip_x"], [[1, 2]], {}, -2, "a joint occurs twice"),
        (PLANE, [], {}, -1, "trajectory.points: 0, expected 1 to 10000"),
        (PLANE, [[1]], {}, -1, r"points\[0\].positions: 1, expected 2"),
        (PLANE, [[1, math.nan]], {}, -1, r"points\[0\].positions: a number is not finite"),
        (PLANE, [[0, -1e308]], {}, -1, r"points\[0\]: -1e\+308"),
        (PLANE, [[1, 2]], {"trajectory": {"header": {"frame_id": "map"}}}, -1, "trajectory.header.frame_id: 'map'"),
        (PLANE, [[1, 2]], tolerance("goal", "tip_x", -2.0), -1, "goal_tolerance: a tolerance is negative"),
        (
            PLANE,
            [[1, 2]],
            tolerance("goal", "elbow", 0.1),
            -2,
            "'elbow', expected joints of the tip: tip_x, tip_y, tip",
        ),
        (PLANE, [[1, 2]], tolerance("path", "tip_yaw", 0.1), -1, "tip_yaw: lines are followed by position only"),
    ],
)
def test_what_is_no_goal_of_the_tip_is_refused(
    joints: list[str], rows: list[list[float]], fields: dict[str, Any], code: int, sentence: str
) -> None:
    with pytest.raises(BadGoal, match=sentence) as refused:
        tip_goal(trajectory_goal(joints, rows, **fields), place())
    assert refused.value.code == code


def test_actuators_that_are_not_named_stay() -> None:
    goal = trajectory_goal(["1.left", "16.right"], [[1, 0], [0.995, 1.005]])
    states = CONTRACTED
    found = actuator_goal(goal, PAPER, states)
    shown = [parse_configuration(PAPER, it["configuration"]) for it in found["waypoints"]]
    bits = [np.concatenate([PAPER.modules[m].bits[k] for m, k in enumerate(it)]) for it in shown]
    assert [np.flatnonzero(it).tolist() for it in bits] == [[0], [0, 47]]


@given(st.lists(st.integers(0, 1), min_size=48, max_size=48))
def test_any_states_of_all_actuators_come_back(states: list[int]) -> None:
    goal = trajectory_goal(list(PAPER.actuators), [[float(it) for it in states]])
    (point,) = actuator_goal(goal, PAPER, [None] * 48)["waypoints"]
    shown = parse_configuration(PAPER, point["configuration"])
    assert np.concatenate([PAPER.modules[m].bits[k] for m, k in enumerate(shown)]).tolist() == states


@pytest.mark.parametrize(
    ("joints", "row", "code", "sentence"),
    [
        ([], [], -2, "joint_names: none"),
        (["99.left"], [1.0], -2, "'99.left' is no actuator, expected names such as '1.left'"),
        (["1.left"], [0.5], -1, r"points\[0\]: 1.left at 0.5, expected 0 or 1"),
        (["1.left"], [2.0], -1, "1.left at 2, expected 0 or 1"),
    ],
)
def test_what_is_no_goal_of_actuators_is_refused(joints: list[str], row: list[float], code: int, sentence: str) -> None:
    with pytest.raises(BadGoal, match=sentence) as refused:
        actuator_goal(trajectory_goal(joints, [row]), PAPER, CONTRACTED)
    assert refused.value.code == code


def test_an_unknown_actuator_must_be_named() -> None:
    states = [None, *CONTRACTED[1:]]
    with pytest.raises(BadGoal, match="module 1 has an actuator of unknown state; give all of its actuators"):
        actuator_goal(trajectory_goal(["2.left"], [[1.0]]), PAPER, states)
    assert actuator_goal(trajectory_goal(["1.left"], [[1.0]]), PAPER, states)["waypoints"]


def test_positions_of_the_tip_are_in_the_order_of_the_joints() -> None:
    assert tip_positions(Pose([1.0, 2.0], 0.5), ("tip_yaw", "tip_y"), place()) == [0.5, 2.0]
    assert math.isnan(tip_positions(Pose([1.0, 2.0]), ("tip_yaw",), place())[0])


def test_ros_has_metres_and_the_daemon_the_unit_of_the_file() -> None:
    base = np.eye(4)
    base[:3, 3] = 0.1, 0.2, 0.0
    lift = Place("world", "lift", base, 2, 0.001)
    header = {"header": {"frame_id": "lift/0"}}
    entries = [{"name": "tip_x", "position": 0.002}]
    goal = trajectory_goal(
        ["tip_x", "tip_y"], [[0.3, 0.4]], trajectory=header, goal_tolerance=entries, path_tolerance=entries
    )
    found = tip_goal(goal, lift)
    assert found["waypoints"][0]["position"] == pytest.approx([400.0, 600.0])
    assert found["tolerance"]["position"] == pytest.approx(2.0)
    assert found["path_tolerance"] == pytest.approx(2.0)
    assert lift.pose(Pose([400.0, 600.0]))["position"] == pytest.approx({"x": 0.4, "y": 0.6, "z": 0.0})
    assert tip_positions(Pose([400.0, 600.0]), ("tip_y", "tip_x"), lift) == pytest.approx([0.6, 0.4])
