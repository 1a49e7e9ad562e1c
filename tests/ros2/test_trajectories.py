"""Goals of FollowJointTrajectory as goals of the daemon, and what is refused with which code."""

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hyperbit.controller.manipulator.notation import parse_configuration
from hyperbit.controller.motion.decoding.goal import parse
from hyperbit.controller.ros2.poses import BadGoal, Place, waypoint
from hyperbit.controller.ros2.trajectories import actuator_goal, time_tolerance, tip_goal, tip_positions
from hyperbit.controller.ros2.wire.cdr import message
from hyperbit.controller.ros2.wire.types import Types
from tests.ros2.samples import chain, message_bytes, place, state, trajectory_goal


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
    assert parse(message_bytes(found)).waypoints[1].position == [0.4, 2.8]


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
    pose = message({**header, "pose": turned}, "geometry_msgs/msg/PoseStamped", Types("jazzy"))
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


@pytest.mark.parametrize(
    ("goal", "code", "sentence"),
    [
        (trajectory_goal(["tip_x"], [[0.5]]), -2, "tip_x, expected tip_x, tip_y, and perhaps tip_yaw"),
        (trajectory_goal(["tip_x", "tip_y", "tip_z"], [[1, 2, 3]]), -2, "expected tip_x, tip_y"),
        (trajectory_goal(["tip_x", "tip_x"], [[1, 2]]), -2, "a joint occurs twice"),
        (trajectory_goal(["tip_x", "tip_y"], []), -1, "trajectory.points: 0, expected 1 to 10000"),
        (trajectory_goal(["tip_x", "tip_y"], [[1]]), -1, r"points\[0\].positions: 1, expected 2"),
        (trajectory_goal(["tip_x", "tip_y"], [[1, math.nan]]), -1, r"points\[0\].positions: a number is not finite"),
        (
            trajectory_goal(["tip_x", "tip_y"], [[1, 2]], trajectory={"header": {"frame_id": "map"}}),
            -1,
            "trajectory.header.frame_id: 'map'",
        ),
        (
            trajectory_goal(["tip_x", "tip_y"], [[1, 2]], goal_tolerance=[{"name": "tip_x", "position": -2.0}]),
            -1,
            "goal_tolerance: a tolerance is negative",
        ),
        (
            trajectory_goal(["tip_x", "tip_y"], [[1, 2]], goal_tolerance=[{"name": "elbow", "position": 0.1}]),
            -2,
            "goal_tolerance: 'elbow', expected joints of the tip: tip_x, tip_y, tip_yaw",
        ),
        (
            trajectory_goal(["tip_x", "tip_y"], [[1, 2]], path_tolerance=[{"name": "tip_yaw", "position": 0.1}]),
            -1,
            "path_tolerance: tip_yaw: lines are followed by position only",
        ),
    ],
)
def test_what_is_no_goal_of_the_tip_is_refused(goal: Any, code: int, sentence: str) -> None:
    with pytest.raises(BadGoal, match=sentence) as refused:
        tip_goal(goal, place())
    assert refused.value.code == code


def test_actuators_that_are_not_named_stay() -> None:
    goal = trajectory_goal(["1.left", "16.right"], [[1, 0], [0.995, 1.005]])
    states = state()["measured"]
    found = actuator_goal(goal, chain(), states)
    shown = [parse_configuration(chain(), it["configuration"]) for it in found["waypoints"]]
    bits = [np.concatenate([chain().modules[m].bits[k] for m, k in enumerate(it)]) for it in shown]
    assert [np.flatnonzero(it).tolist() for it in bits] == [[0], [0, 47]]


@given(st.lists(st.integers(0, 1), min_size=48, max_size=48))
def test_any_states_of_all_actuators_come_back(states: list[int]) -> None:
    goal = trajectory_goal(list(chain().actuators), [[float(it) for it in states]])
    (point,) = actuator_goal(goal, chain(), [None] * 48)["waypoints"]
    shown = parse_configuration(chain(), point["configuration"])
    assert np.concatenate([chain().modules[m].bits[k] for m, k in enumerate(shown)]).tolist() == states


@pytest.mark.parametrize(
    ("joints", "row", "code", "sentence"),
    [
        (["99.left"], [1.0], -2, "'99.left' is no actuator, expected names such as '1.left'"),
        (["1.left"], [0.5], -1, r"points\[0\]: 1.left at 0.5, expected 0 or 1"),
        (["1.left"], [2.0], -1, "1.left at 2, expected 0 or 1"),
    ],
)
def test_what_is_no_goal_of_actuators_is_refused(joints: list[str], row: list[float], code: int, sentence: str) -> None:
    with pytest.raises(BadGoal, match=sentence) as refused:
        actuator_goal(trajectory_goal(joints, [row]), chain(), state()["measured"])
    assert refused.value.code == code


def test_an_unknown_actuator_must_be_named() -> None:
    states = [None, *state()["measured"][1:]]
    with pytest.raises(BadGoal, match="module 1 has an actuator of unknown state; give all of its actuators"):
        actuator_goal(trajectory_goal(["2.left"], [[1.0]]), chain(), states)
    assert actuator_goal(trajectory_goal(["1.left"], [[1.0]]), chain(), states)["waypoints"]


def test_positions_of_the_tip_are_in_the_order_of_the_joints() -> None:
    assert tip_positions({"position": [1.0, 2.0], "orientation": 0.5}, ("tip_yaw", "tip_y")) == [0.5, 2.0]
    assert math.isnan(tip_positions({"position": [1.0, 2.0]}, ("tip_yaw",))[0])
