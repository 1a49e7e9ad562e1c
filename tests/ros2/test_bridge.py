"""The bridge as ROS 2 sees it, with a real daemon and simulated boards: topics, services, actions, refusals."""

import json
import math
import struct
import threading
import time
import uuid
from collections import Counter
from collections.abc import Iterator
from contextlib import ExitStack
from typing import Any

import pytest
import zenoh
import zenoh.ext

from hyperbit.controller.ros2.wire import qos
from hyperbit.controller.ros2.wire.node import Node
from hyperbit.controller.ros2.wire.services import NoReply
from hyperbit.controller.ros2.wire.session import Session
from hyperbit.controller.ros2.wire.tokens import Kind
from tests.ros2.client import ABORTED, CANCELED, SUCCEEDED, Client, Result, trajectory
from tests.ros2.rig import PATIENCE, TIP, Rig, begin, result_of
from tests.waiting import eventually

pytestmark = pytest.mark.timeout(900)
AGAIN = 2.0  # [s]; a message may come before the subscriber is known
STAMPED, TRIGGER = "geometry_msgs/msg/PoseStamped", "std_srvs/srv/Trigger"


@pytest.fixture(scope="module")
def rig(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Rig]:
    with ExitStack() as closing:
        rig = Rig(tmp_path_factory.mktemp("ros2"), closing)
        rig.await_ready()
        yield rig


def publish(rig: Rig, topic: str, type_name: str, fields: dict[str, Any], *words: str) -> str:
    """Publishes a message until the bridge tells these words of it."""
    publisher, since, sent = rig.node.publisher(topic, type_name), len(rig.said), [-math.inf]

    def told() -> str:
        if time.monotonic() > sent[-1] + AGAIN:
            publisher.publish(fields)
            sent.append(time.monotonic())
        return next((it for it in rig.said[since:] if all(word in it for word in words)), "")

    try:
        return eventually(told, PATIENCE, lambda: f"{words}: {rig.said[since:]}")
    finally:
        publisher.close()


def stamped(x: float, y: float, **header: Any) -> dict[str, Any]:
    return {"header": header, "pose": {"position": {"x": x, "y": y}}}


def test_the_node_and_its_endpoints_are_on_the_network(rig: Rig) -> None:
    tokens = [it for it in rig.session.tokens() if it.namespace == "/flat"]
    assert [it.node for it in tokens if it.kind is Kind.NODE] == ["hyperbit"]
    found = {(it.kind, it.endpoint.name) for it in tokens if it.endpoint}
    published = ("/flat/joint_states", "/flat/tip_pose", "/tf", "/tf_static", "/diagnostics", "/rosout")
    assert found >= {(Kind.PUBLISHER, name) for name in (*published, "/flat/robot_description")}
    assert found >= {(Kind.SUBSCRIBER, f"/flat/{name}") for name in ("goal_pose", "goal_path", "setpoint")}
    assert found >= {(Kind.SERVICE, f"/flat/{name}") for name in ("stop", "reset", "cancel", "plan")}
    for action in ("tip_controller", "actuator_controller"):
        base = f"/flat/{action}/follow_joint_trajectory/_action"
        assert found >= {(Kind.SERVICE, f"{base}/{name}") for name in ("send_goal", "get_result", "cancel_goal")}
        assert found >= {(Kind.PUBLISHER, f"{base}/{name}") for name in ("feedback", "status")}


def test_states_frames_and_diagnostics_come(rig: Rig) -> None:
    joints = rig.hear("/flat/joint_states", "sensor_msgs/msg/JointState")
    frames = rig.hear("/tf", "tf2_msgs/msg/TFMessage", qos.TF)
    fixed = rig.hear("/tf_static", "tf2_msgs/msg/TFMessage", qos.TF_STATIC)
    robot = rig.hear("/flat/robot_description", "std_msgs/msg/String", qos.LATCHED)
    markers = rig.hear("/flat/visualization_marker_array", "visualization_msgs/msg/MarkerArray")
    for heard in (joints, frames, fixed, robot, markers):
        eventually(lambda heard=heard: heard, PATIENCE)
    assert len(joints[-1].name) == len(joints[-1].position) == 48
    assert set(joints[-1].position) <= {0.0, 1.0}
    assert abs(joints[-1].header.stamp.sec - time.time()) < 3600
    assert [it.child_frame_id for it in frames[-1].transforms] == [f"flat/{k}" for k in range(1, 17)]
    assert {it.child_frame_id for it in fixed[-1].transforms} == {"flat/0", "flat/tip"}
    assert robot[-1].data.startswith("<?xml")
    assert len(markers[-1].markers) >= 16


def test_services_stop_reset_and_plan(rig: Rig) -> None:
    stop, reset = (rig.node.client(f"/flat/{name}", TRIGGER) for name in ("stop", "reset"))
    assert stop.call({}, PATIENCE).message.success
    refused = publish(rig, "/flat/goal_pose", STAMPED, stamped(0.4, 2.9, frame_id="world"), "refused", "stopped")
    assert "reset" in refused
    assert reset.call({}, PATIENCE).message.success
    rig.await_ready()
    plan = rig.node.client("/flat/plan", "nav_msgs/srv/GetPlan")
    (point,) = plan.call({"goal": stamped(0.4, 2.9, frame_id="world")}, PATIENCE).message.plan.poses
    assert math.dist((point.pose.position.x, point.pose.position.y), (0.4, 2.9)) < 0.002
    assert not plan.call({"goal": stamped(9, 9)}, PATIENCE).message.plan.poses
    rig.await_words("no plan", "out of reach")


def test_a_pose_and_a_path_are_goals(rig: Rig) -> None:
    publish(rig, "/flat/goal_pose", STAMPED, stamped(0.4, 2.9, frame_id="world"), "succeeded: reached")
    path = {"poses": [stamped(0.45, 2.85), stamped(0.5, 2.8)]}
    publish(rig, "/flat/goal_path", "nav_msgs/msg/Path", path, "goal_path", "succeeded: reached")


@pytest.mark.parametrize(
    ("topic", "fields", "words"),
    [
        ("goal_pose", stamped(0.4, 2.9, frame_id="map"), "frame_id: 'map', expected 'world' or 'flat/0'"),
        ("goal_pose", stamped(0.4, 2.9, stamp={"sec": 1_000_000_000}), "s old, expected at most 5 s, or 0"),
        ("setpoint", stamped(0.4, math.inf), "a set-point is refused: setpoint.pose.position.y: inf"),
    ],
)
def test_bad_poses_are_refused_in_words_and_nothing_moves(
    rig: Rig, topic: str, fields: dict[str, Any], words: str
) -> None:
    rig.await_end()
    joints = rig.hear("/flat/joint_states", "sensor_msgs/msg/JointState")
    before = eventually(lambda: joints, PATIENCE)[-1].position.tolist()
    publish(rig, f"/flat/{topic}", STAMPED, fields, words)
    joints.clear()
    assert eventually(lambda: joints, PATIENCE)[-1].position.tolist() == before


def test_messages_of_a_wrong_hash_are_told_and_move_nothing(rig: Rig) -> None:
    rig.await_end()
    joints = rig.hear("/flat/joint_states", "sensor_msgs/msg/JointState")
    before = eventually(lambda: joints, PATIENCE)[-1].position.tolist()
    since = len(rig.said)
    with Session(rig.router.endpoint, PATIENCE) as session:
        node = Node(session, "foreign")
        wrong = "RIHS01_" + "0" * 64
        node.types.hashes = {**node.types.hashes, STAMPED: wrong, TRIGGER: wrong}
        publisher, stop = node.publisher("/flat/goal_pose", STAMPED), node.client("/flat/stop", TRIGGER)
        for topic in ("/flat/goal_pose", "/flat/stop"):
            rig.await_words(f"{topic}: no messages are exchanged with '/foreign'", wrong, since=since)
        publisher.publish(stamped(1.4, 2.3))
        with pytest.raises(NoReply):
            stop.call({}, 1.0)
    publish(rig, "/flat/goal_pose", STAMPED, stamped(math.nan, 2.9), "position.x: nan")  # it came later
    joints.clear()
    assert eventually(lambda: joints, PATIENCE)[-1].position.tolist() == before


def test_a_goal_of_the_tip_succeeds(rig: Rig) -> None:
    client, goal = rig.client(), uuid.uuid4().bytes
    assert begin(client, goal, 0.5, 2.8)
    result = result_of(client, goal)
    assert (result.status, result.error_code) == (SUCCEEDED, 0)
    assert result.error_string == "succeeded: reached"
    assert result_of(client, goal) == result, "a result can be asked for again"
    assert begin(client, uuid.uuid4().bytes, 0.3, 2.85)


def test_a_goal_of_actuators(rig: Rig) -> None:
    client, goal = rig.client("flat/actuator_controller/follow_joint_trajectory"), uuid.uuid4().bytes
    joints = rig.hear("/flat/joint_states", "sensor_msgs/msg/JointState")
    labels = list(eventually(lambda: joints, PATIENCE)[-1].name)
    states = [float(k % 2) for k in range(48)]
    answer = eventually(lambda: client.send(goal, trajectory(labels, [states], 0.0)), PATIENCE)
    assert answer[0], rig.said
    assert result_of(client, goal).status == SUCCEEDED
    eventually(lambda: joints[-1].position.tolist() == states, PATIENCE)


def test_goals_out_of_reach_or_of_other_joints_are_rejected_in_words(rig: Rig) -> None:
    client = rig.client()
    since = len(rig.said)
    assert not begin(client, uuid.uuid4().bytes, 9.0, 9.0)
    rig.await_words(f"a goal of {TIP.removeprefix('flat/')} is rejected (code -5)", "out of reach", since=since)
    answer = client.send(uuid.uuid4().bytes, trajectory(["elbow"], [[1.0]], 0.0))
    assert answer is not None
    assert not answer[0]
    rig.await_words("code -2", "elbow, expected tip_x, tip_y", since=since)
    old = struct.pack("<i", 1_000_000_000) + trajectory(["tip_x", "tip_y"], [[0.5, 2.8]], 0.0)[4:]
    answer = client.send(uuid.uuid4().bytes, old)
    assert answer is not None
    assert not answer[0]
    rig.await_words("code -3", since=since)


def test_a_hundred_goals_have_a_hundred_results(rig: Rig) -> None:
    """Most are replaced by the next, some are canceled, and of each tenth the client waits for the end."""
    client, ends, waiting = rig.client(), list[tuple[bytes, Result]](), list[threading.Thread]()
    rejected = 0
    for number in range(100):
        goal, place = uuid.uuid4().bytes, ((0.5, 2.8), (0.3, 2.85), (0.4, 2.9))[number % 3]
        if not begin(client, goal, *place):
            rejected += 1
            continue
        thread = threading.Thread(target=lambda goal=goal: ends.append((goal, result_of(client, goal))))  # type: ignore[misc]
        thread.start()
        waiting.append(thread)
        if number % 10 == 4:
            client.cancel(goal)
        if number % 10 == 9:
            thread.join(PATIENCE)
    for thread in waiting:
        thread.join(PATIENCE)
    assert rejected == 0, rig.said[-20:]
    assert len({goal for goal, _ in ends}) == len(ends) == 100
    found = Counter(it.error_string.partition(":")[0] for _, it in ends)
    assert set(found) <= {"succeeded", "replaced", "canceled"}, found
    assert found["succeeded"] >= 10, found
    assert all((it.status == SUCCEEDED) == it.error_string.startswith("succeeded") for _, it in ends)


def test_everything_reappears_after_the_routers_loss(rig: Rig) -> None:
    """Seen by a session of Zenoh that has nothing of the bridge's code."""
    settings = {"mode": "client", "connect": {"endpoints": [rig.router.endpoint]}, "timestamping": {"enabled": True}}

    def tokens(session: zenoh.Session) -> set[str]:
        found = {str(it.ok.key_expr) for it in session.liveliness().get("@ros2_lv/0/**") if it.ok}
        return {it for it in found if "/%flat/hyperbit" in it}

    with zenoh.open(zenoh.Config.from_json5(json.dumps(settings))) as before:
        expected = eventually(lambda: tokens(before), PATIENCE)
    rig.router.stop()
    rig.router.start()
    got: dict[str, list[bytes]] = {}
    with zenoh.open(zenoh.Config.from_json5(json.dumps(settings))) as after:
        eventually(lambda: tokens(after) == expected, PATIENCE)
        assert len(expected) > 20
        latched = ("flat/robot_description", "tf_static", "flat/tip_controller/follow_joint_trajectory/_action/status")
        history = zenoh.ext.HistoryConfig(detect_late_publishers=True, max_samples=1)
        for name in (*latched, "flat/joint_states"):
            heard = got[name] = []
            options = {"history": history} if name in latched else {}
            take = lambda it, heard=heard: heard.append(it.payload.to_bytes())  # noqa: E731
            zenoh.ext.declare_advanced_subscriber(after, f"0/{name}/*/*", take, **options)
        eventually(lambda: all(got.values()), PATIENCE, lambda: str({name: len(it) for name, it in got.items()}))
        assert b"<robot name" in got["flat/robot_description"][0]
        client, goal = Client(after, TIP), uuid.uuid4().bytes
        assert begin(client, goal, 0.5, 2.8)
        assert result_of(client, goal).status == SUCCEEDED


def test_a_running_goal_is_canceled_or_replaced(rig: Rig) -> None:
    client, goals = rig.client(), [uuid.uuid4().bytes for _ in range(2)]
    hour = trajectory(["tip_x", "tip_y"], [[0.5, 2.8], [0.3, 2.85]], 1800.0)
    assert (client.send(goals[0], hour) or (False,))[0]
    eventually(lambda: [it for it, _ in client.feedback if it == goals[0]], PATIENCE)
    assert (client.send(goals[1], hour) or (False,))[0]
    replaced = result_of(client, goals[0])
    assert (replaced.status, replaced.error_string.partition(":")[0]) == (ABORTED, "replaced")
    assert client.cancel(goals[1]).goals == [goals[1]]
    canceled = result_of(client, goals[1])
    assert (canceled.status, canceled.error_string.partition(":")[0]) == (CANCELED, "canceled")
