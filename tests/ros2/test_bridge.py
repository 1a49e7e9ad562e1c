"""The bridge as ROS 2 sees it, with a real daemon and simulated boards: topics, services, actions, refusals, kills."""

import math
import time
from collections.abc import Iterator
from contextlib import ExitStack
from typing import Any

import pytest

from hyperbit.controller.ros2.wire import qos
from hyperbit.controller.ros2.wire.actions import Status
from hyperbit.controller.ros2.wire.node import Node
from hyperbit.controller.ros2.wire.session import Session
from hyperbit.controller.ros2.wire.tokens import Kind
from tests.ros2.client import tip, trajectory
from tests.ros2.kills import GOES_ON, HOUR, kill
from tests.ros2.processes import PATIENCE, System
from tests.waiting import eventually

pytestmark = [pytest.mark.timeout(900), pytest.mark.real_time]
AGAIN = 2.0  # [s]; a message may come before the subscriber is known
STAMPED, TRIGGER = "geometry_msgs/msg/PoseStamped", "std_srvs/srv/Trigger"


@pytest.fixture(scope="module")
def system() -> Iterator[System]:
    with ExitStack() as closing:
        system = System(closing)
        system.await_ready()
        yield system


def publish(system: System, topic: str, type_name: str, fields: dict[str, Any], *words: str) -> str:
    """Publishes a message until the bridge tells these words of it."""
    publisher, since, sent = system.node.publisher(topic, type_name), len(system.said), [-math.inf]

    def told() -> str:
        if time.monotonic() > sent[-1] + AGAIN:
            publisher.publish(fields)
            sent.append(time.monotonic())
        return next((it for it in system.said[since:] if all(word in it for word in words)), "")

    try:
        return eventually(told, PATIENCE, lambda: f"{words}: {system.said[since:]}")
    finally:
        publisher.close()


def stamped(x: float, y: float, **header: Any) -> dict[str, Any]:
    return {"header": header, "pose": {"position": {"x": x, "y": y}}}


def test_the_node_and_its_endpoints_are_on_the_network(system: System) -> None:
    tokens = [it for it in system.session.tokens() if it.namespace == "/flat"]
    assert [it.node for it in tokens if it.kind is Kind.NODE] == ["hyperbit"]
    found = {(it.kind, it.endpoint.name) for it in tokens if it.endpoint}
    published = ("/flat/joint_states", "/flat/tip_pose", "/tf", "/tf_static", "/diagnostics", "/rosout")
    assert found >= {(Kind.PUBLISHER, name) for name in (*published, "/flat/robot_description")}
    assert found >= {
        (Kind.SUBSCRIBER, f"/flat/{name}") for name in ("goal_pose", "goal_path", "setpoint", "measured_tip")
    }
    assert found >= {(Kind.SERVICE, f"/flat/{name}") for name in ("stop", "reset", "cancel", "plan")}
    for action in ("tip_controller", "actuator_controller"):
        base = f"/flat/{action}/follow_joint_trajectory/_action"
        assert found >= {(Kind.SERVICE, f"{base}/{name}") for name in ("send_goal", "get_result", "cancel_goal")}
        assert found >= {(Kind.PUBLISHER, f"{base}/{name}") for name in ("feedback", "status")}


def test_states_frames_and_the_robot_come(system: System) -> None:
    joints = system.hear("/flat/joint_states", "sensor_msgs/msg/JointState")
    frames = system.hear("/tf", "tf2_msgs/msg/TFMessage", qos.TF)
    fixed = system.hear("/tf_static", "tf2_msgs/msg/TFMessage", qos.TF_STATIC)
    robot = system.hear("/flat/robot_description", "std_msgs/msg/String", qos.LATCHED)
    markers = system.hear("/flat/visualization_marker_array", "visualization_msgs/msg/MarkerArray")
    for heard in (joints, frames, fixed, robot, markers):
        eventually(lambda heard=heard: heard, PATIENCE)
    assert abs(joints[-1].header.stamp.sec - time.time()) < 3600
    assert [it.child_frame_id for it in frames[-1].transforms] == [f"flat/{k}" for k in range(1, 17)]
    assert {it.child_frame_id for it in fixed[-1].transforms} == {"flat/0", "flat/tip"}
    assert robot[-1].data.startswith("<?xml")
    assert len(markers[-1].markers) >= 16


def test_services_stop_reset_and_plan(system: System) -> None:
    stop, reset = (system.node.client(f"/flat/{name}", TRIGGER) for name in ("stop", "reset"))
    assert stop.call({}, PATIENCE).message.success
    refused = publish(system, "/flat/goal_pose", STAMPED, stamped(0.4, 2.9, frame_id="world"), "refused", "stopped")
    assert "reset" in refused
    assert reset.call({}, PATIENCE).message.success
    system.await_ready()
    plan = system.node.client("/flat/plan", "nav_msgs/srv/GetPlan")
    (point,) = plan.call({"goal": stamped(0.4, 2.9, frame_id="world")}, PATIENCE).message.plan.poses
    assert math.dist((point.pose.position.x, point.pose.position.y), (0.4, 2.9)) < 0.002
    assert not plan.call({"goal": stamped(9, 9)}, PATIENCE).message.plan.poses
    system.await_words("no plan", "out of reach")


def test_a_pose_and_a_path_are_goals(system: System) -> None:
    publish(system, "/flat/goal_pose", STAMPED, stamped(0.4, 2.9, frame_id="world"), "succeeded: reached")
    path = {"poses": [stamped(0.45, 2.85), stamped(0.5, 2.8)]}
    publish(system, "/flat/goal_path", "nav_msgs/msg/Path", path, "goal_path", "succeeded: reached")


def test_a_peer_with_another_hash_is_told(system: System) -> None:
    wrong = "RIHS01_" + "0" * 64
    with Session(system.router.endpoint, PATIENCE) as session:
        node = Node(session, "foreign")
        node.types.hashes = {**node.types.hashes, STAMPED: wrong}
        node.publisher("/flat/goal_pose", STAMPED)
        system.await_words("/flat/goal_pose: no messages are exchanged with '/foreign'", wrong)


def test_a_goal_of_actuators(system: System) -> None:
    joints = system.hear("/flat/joint_states", "sensor_msgs/msg/JointState")
    labels = list(eventually(lambda: joints, PATIENCE)[-1].name)
    states = [float(k % 2) for k in range(48)]
    goal, accepted = system.begin(system.actuators, trajectory(labels, [states], 0.0))
    assert accepted, system.said
    assert system.result(system.actuators, goal).status is Status.SUCCEEDED
    eventually(lambda: joints[-1].position.tolist() == states, PATIENCE)


def test_a_goal_out_of_reach_is_rejected_in_words(system: System) -> None:
    assert not system.begin(system.tip, tip((9.0, 9.0)))[1]
    system.await_words("a goal of tip_controller/follow_joint_trajectory is rejected (code -5)", "out of reach")


def test_each_goal_is_canceled_replaced_or_succeeds(system: System) -> None:
    client, hour = system.tip, tip((0.5, 2.8), (0.3, 2.85), step=HOUR)
    for end in ("replaced", "canceled"):
        goals = [system.begin(client, hour)[0] for _ in range(20)]
        eventually(lambda last=goals[-1]: [it for it in client.feedback if bytes(it.goal_id.uuid) == last], PATIENCE)
        if end == "canceled":
            assert client.cancel(goals[-1])[1] == goals[-1:]
        last, accepted = system.begin(client, tip((0.4, 2.9)))
        assert accepted, system.said[-20:]
        ends = [system.result(client, goal) for goal in (*goals, last)]
        assert {it[:2] for it in ends[:-2]} == {(Status.ABORTED, -1)}
        assert ends[-2].error_string.startswith(end)
        assert ends[-1] == (Status.SUCCEEDED, 0, "succeeded: reached")


@pytest.mark.parametrize("victim", ["router", "bridge", "daemon"])
def test_each_accepted_goal_has_one_result_over_kills(system: System, victim: str) -> None:
    assert kill(system, victim) in (("canceled",) if victim in GOES_ON else ("aborted", "lost"))
