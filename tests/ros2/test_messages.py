"""States and diagnostics of the daemon as messages of ROS 2; each must fit its type."""

import math
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
import yaml
from msgspec import convert
from scipy.spatial.transform import Rotation

from hyperbit.controller.messages.state import Diagnostics
from hyperbit.controller.pictures.scene import FoxgloveScene
from hyperbit.controller.ros2 import messages
from hyperbit.controller.ros2.poses import Place
from hyperbit.controller.ros2.robot import angles, urdf
from hyperbit.controller.ros2.wire import tokens
from hyperbit.controller.ros2.wire.cdr import deserialize, serialize
from hyperbit.controller.ros2.wire.tokens import Kind
from tests import told
from tests.keys import DEPLOY
from tests.ros2.rig import Rig
from tests.ros2.world.inputs import TYPES
from tests.told import arm, read_arm, read_state


def sent(fields: object, name: str) -> object:
    return deserialize(serialize(fields, name, TYPES), name, TYPES)


def test_joints_are_0_or_1_or_unknown() -> None:
    measured = [1, None, *[0] * 46]
    fields = messages.joint_state(read_state(measured=measured), arm().manipulator.actuators)
    it = sent(fields, "sensor_msgs/msg/JointState")
    assert it.name[:3] == ["1.left", "1.diagonal", "1.right"]
    assert (it.position[0], it.position[2]) == (1.0, 0.0)
    assert math.isnan(it.position[1])
    assert it.header.stamp.sec == 1_500_000_000


@pytest.mark.parametrize("name", ["planar16", "platform8"])
def test_frames_lead_from_the_world_to_the_tip(name: str) -> None:
    scene = FoxgloveScene(read_arm(name))
    fields = {"transforms": messages.transforms(scene, read_state(name), "map")}
    frames = sent(fields, "tf2_msgs/msg/TFMessage").transforms
    assert [it.child_frame_id for it in frames] == [
        f"{name}/{k}" for k in range(len(arm(name).manipulator.modules) + 1)
    ]
    assert [it.header.frame_id for it in frames] == ["map", *(it.child_frame_id for it in frames[:-1])]
    whole = np.eye(4)
    for it in frames:
        turn, place = it.transform.rotation, it.transform.translation
        own = np.eye(4)
        own[:3, :3] = Rotation.from_quat([turn.x, turn.y, turn.z, turn.w]).as_matrix()
        own[:3, 3] = place.x, place.y, place.z
        whole = whole @ own
    tip = messages.tip_pose(read_state(name), Place("map", name, np.eye(4), arm(name).manipulator.dimension))
    assert tip is not None
    shown = sent(tip, "geometry_msgs/msg/PoseStamped").pose.position
    assert whole[:3, 3] == pytest.approx([shown.x, shown.y, shown.z], abs=1e-6)


def test_a_tip_that_is_not_known_is_not_shown() -> None:
    assert messages.tip_pose(read_state(tip=None), Place("world", "planar16", np.eye(4), 2)) is None


def test_markers_that_are_gone_are_deleted() -> None:
    obstacles = [{"name": "a", "disc": {"centre": [2.0, 2.0], "radius": 0.3}}]
    markers = messages.Markers(FoxgloveScene(read_arm(obstacles=obstacles)), "planar16", 4.0, "world")
    form, goal = "visualization_msgs/msg/MarkerArray", read_state(target={"position": [0.5, 2.8]})
    first = sent(markers.array(goal), form).markers
    assert len(first) == 16 + 2
    assert len({(it.ns, it.id) for it in first}) == 18
    markers.scene = FoxgloveScene(read_arm(obstacles=[]))
    second = sent(markers.array(read_state()), form).markers
    assert {it.ns for it in second if it.action == messages.DELETE} == {"planar16 goal", "planar16 obstacles"}
    assert len(second) == 16 + 2


def test_diagnostics_are_in_words() -> None:
    health = convert(told.DIAGNOSTICS, Diagnostics)
    reason = {"mode": "fault", "reason": "can0/5 is silent", "faults": [told.FAULT], "homing": ["1.left", "1.right"]}
    fields = messages.diagnostics("a", read_state(**reason), health)
    found = {it.name: it for it in sent(fields, "diagnostic_msgs/msg/DiagnosticArray").status}
    assert {name: int(it.level) for name, it in found.items()} == {
        "a: arm": messages.FAULTY,
        "a: can0/5: board-lost": messages.FAULTY,
        "a: bus can0": messages.OK,
        "a: board can0/5": messages.FAULTY,
        "a: loop": messages.OK,
    }
    assert found["a: arm"].message == "fault: can0/5 is silent"
    assert ("homing", "1.left, 1.right") in [(it.key, it.value) for it in found["a: arm"].values]
    assert ("load", "0.1") in [(it.key, it.value) for it in found["a: bus can0"].values]


@pytest.mark.parametrize("name", ["planar16", "motor12", "platform8"])
def test_the_robot_is_one_tree_with_a_joint_an_actuator(name: str) -> None:
    robot = ElementTree.fromstring(urdf(name, "world", arm(name).manipulator))
    links = [it.get("name") for it in robot.iter("link")]
    joints = {it.get("name"): it for it in robot.iter("joint")}
    assert len(set(links)) == len(links) == len(joints) + 1
    assert {name for name, it in joints.items() if it.get("type") == "prismatic"} == set(
        arm(name).manipulator.actuators
    )
    parents = {it.find("child").get("link"): it.find("parent").get("link") for it in joints.values()}  # type: ignore[union-attr]
    assert set(links) - set(parents) == {"world"}
    assert parents[f"{name}/tip"] == f"{name}/{len(arm(name).manipulator.modules)}"


def test_angles_about_fixed_axes_give_the_frame() -> None:
    for given in ((0.1, 0.2, 0.3), (-2.0, 1.2, 3.0), (0.4, np.pi / 2, 0.0), (0.4, -np.pi / 2, 0.0)):
        frame = np.eye(4)
        frame[:3, :3] = Rotation.from_euler("xyz", given).as_matrix()
        assert angles(frame) == pytest.approx(given)


SHOWN = {  # types by what RViz shows or sends
    "rviz_default_plugins/MarkerArray": "visualization_msgs::msg::dds_::MarkerArray_",
    "rviz_default_plugins/Pose": "geometry_msgs::msg::dds_::PoseStamped_",
    "rviz_default_plugins/SetGoal": "geometry_msgs::msg::dds_::PoseStamped_",
}


def test_rviz_is_configured_for_topics_of_the_bridge(rig: Rig) -> None:
    manager: dict[str, Any] = yaml.safe_load((DEPLOY / "planar16.rviz").read_text())["Visualization Manager"]
    wanted = [it for it in (*manager["Displays"], *manager["Tools"]) if "Topic" in it]
    assert [it["Class"] for it in wanted] == list(SHOWN)
    assert manager["Global Options"]["Fixed Frame"] == "world"
    found = [tokens.parse(it) for it in rig.network.tokens]
    offered = {(it.kind, it.endpoint.name): it.endpoint for it in found if it.endpoint}
    for one in wanted:
        topic = one["Topic"]
        kind = Kind.SUBSCRIBER if one["Class"].endswith("SetGoal") else Kind.PUBLISHER
        endpoint = offered[kind, topic["Value"]]
        assert endpoint.type == SHOWN[one["Class"]]
        assert endpoint.qos.startswith("::")  # reliable and volatile
        assert (topic["Reliability Policy"], topic["Durability Policy"]) == ("Reliable", "Volatile")
