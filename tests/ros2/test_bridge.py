"""The bridge as ROS 2 sees it, with a real daemon and simulated boards: topics, services, actions, refusals, kills."""

import json
import math
import threading
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import ExitStack
from typing import Any

import pytest
import zenoh
import zenoh.ext

from hyperbit.controller.ros2.wire import qos
from hyperbit.controller.ros2.wire.action_events import Status
from hyperbit.controller.ros2.wire.node import Node
from hyperbit.controller.ros2.wire.services import NoReply
from hyperbit.controller.ros2.wire.session import Session
from hyperbit.controller.ros2.wire.tokens import Kind
from tests.ros2.client import Result, tip, trajectory
from tests.ros2.kills import GOES_ON, HOUR, kill
from tests.ros2.processes import PATIENCE, TIP, System
from tests.waiting import eventually

pytestmark = pytest.mark.timeout(900)
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
    assert found >= {(Kind.SUBSCRIBER, f"/flat/{name}") for name in ("goal_pose", "goal_path", "setpoint")}
    assert found >= {(Kind.SERVICE, f"/flat/{name}") for name in ("stop", "reset", "cancel", "plan")}
    for action in ("tip_controller", "actuator_controller"):
        base = f"/flat/{action}/follow_joint_trajectory/_action"
        assert found >= {(Kind.SERVICE, f"{base}/{name}") for name in ("send_goal", "get_result", "cancel_goal")}
        assert found >= {(Kind.PUBLISHER, f"{base}/{name}") for name in ("feedback", "status")}


def test_states_frames_and_diagnostics_come(system: System) -> None:
    joints = system.hear("/flat/joint_states", "sensor_msgs/msg/JointState")
    frames = system.hear("/tf", "tf2_msgs/msg/TFMessage", qos.TF)
    fixed = system.hear("/tf_static", "tf2_msgs/msg/TFMessage", qos.TF_STATIC)
    robot = system.hear("/flat/robot_description", "std_msgs/msg/String", qos.LATCHED)
    markers = system.hear("/flat/visualization_marker_array", "visualization_msgs/msg/MarkerArray")
    for heard in (joints, frames, fixed, robot, markers):
        eventually(lambda heard=heard: heard, PATIENCE)
    assert len(joints[-1].name) == len(joints[-1].position) == 48
    assert set(joints[-1].position) <= {0.0, 1.0}
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


def test_messages_of_a_wrong_hash_are_told_and_move_nothing(system: System) -> None:
    joints = system.hear("/flat/joint_states", "sensor_msgs/msg/JointState")
    before = eventually(lambda: joints, PATIENCE)[-1].position.tolist()
    since = len(system.said)
    with Session(system.router.endpoint, PATIENCE) as session:
        node = Node(session, "foreign")
        wrong = "RIHS01_" + "0" * 64
        node.types.hashes = {**node.types.hashes, STAMPED: wrong, TRIGGER: wrong}
        publisher, stop = node.publisher("/flat/goal_pose", STAMPED), node.client("/flat/stop", TRIGGER)
        for topic in ("/flat/goal_pose", "/flat/stop"):
            system.await_words(f"{topic}: no messages are exchanged with '/foreign'", wrong, since=since)
        publisher.publish(stamped(1.4, 2.3))
        with pytest.raises(NoReply):
            stop.call({}, 1.0)
    publish(system, "/flat/goal_pose", STAMPED, stamped(math.nan, 2.9), "position.x: nan")  # it came later
    joints.clear()
    assert eventually(lambda: joints, PATIENCE)[-1].position.tolist() == before


def test_a_goal_of_actuators(system: System) -> None:
    joints = system.hear("/flat/joint_states", "sensor_msgs/msg/JointState")
    labels = list(eventually(lambda: joints, PATIENCE)[-1].name)
    states = [float(k % 2) for k in range(48)]
    goal, accepted = system.begin(system.actuators, trajectory(labels, [states], 0.0))
    assert accepted, system.said
    assert system.result(system.actuators, goal).status is Status.SUCCEEDED
    eventually(lambda: joints[-1].position.tolist() == states, PATIENCE)


OLD = tip((0.5, 2.8)) | {"trajectory": tip((0.5, 2.8))["trajectory"] | {"header": {"stamp": {"sec": 1_000_000_000}}}}


@pytest.mark.parametrize(
    ("goal", "words"),
    [
        (tip((9.0, 9.0)), (f"a goal of {TIP.removeprefix('/flat/')} is rejected (code -5)", "out of reach")),
        (trajectory(["elbow"], [[1.0]]), ("code -2", "elbow, expected tip_x, tip_y")),
        (OLD, ("code -3",)),
    ],
)
def test_goals_that_cannot_be_reached_are_rejected_in_words(
    system: System, goal: dict[str, Any], words: tuple[str, ...]
) -> None:
    since = len(system.said)
    assert not system.begin(system.tip, goal)[1]
    system.await_words(*words, since=since)


def test_a_hundred_goals_have_a_hundred_results(system: System) -> None:
    """Most are replaced by the next, some are canceled, and of each tenth the client waits for the end."""
    client, ends, waiting = system.tip, dict[bytes, Result](), list[threading.Thread]()
    for number in range(100):
        goal, accepted = system.begin(client, tip(((0.5, 2.8), (0.3, 2.85), (0.4, 2.9))[number % 3]))
        assert accepted, system.said[-20:]
        thread = threading.Thread(target=lambda goal=goal: ends.update({goal: system.result(client, goal)}))  # type: ignore[misc]
        thread.start()
        waiting.append(thread)
        if number % 10 == 4:
            client.cancel(goal)
        if number % 10 == 9:
            thread.join(PATIENCE)
    for thread in waiting:
        thread.join(PATIENCE)
    found = Counter(it.error_string.partition(":")[0] for it in ends.values())
    assert len(ends) == 100
    assert set(found) <= {"succeeded", "replaced", "canceled"}, found
    assert found["succeeded"] >= 10, found
    assert all((it.status is Status.SUCCEEDED) == it.error_string.startswith("succeeded") for it in ends.values())


def test_everything_reappears_after_the_routers_loss(system: System) -> None:
    """Seen by a session of Zenoh that has nothing of the bridge's code."""
    settings = {"mode": "client", "connect": {"endpoints": [system.router.endpoint]}, "timestamping": {"enabled": True}}

    def tokens(session: zenoh.Session) -> set[str]:
        found = {str(it.ok.key_expr) for it in session.liveliness().get("@ros2_lv/0/**") if it.ok}
        return {it for it in found if "/%flat/hyperbit" in it}

    with zenoh.open(zenoh.Config.from_json5(json.dumps(settings))) as before:
        expected = eventually(lambda: tokens(before), PATIENCE)
    system.kill("router")
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
    goal, accepted = system.begin(system.tip, tip((0.5, 2.8)))
    assert accepted
    assert system.result(system.tip, goal) == (Status.SUCCEEDED, 0, "succeeded: reached")
    assert system.result(system.tip, goal) == system.result(system.tip, goal), "a result can be asked for again"


def test_a_running_goal_is_canceled_or_replaced(system: System) -> None:
    client, hour = system.tip, tip((0.5, 2.8), (0.3, 2.85), step=HOUR)
    first, _ = system.begin(client, hour)
    eventually(lambda: [it for it in client.feedback if bytes(it.goal_id.uuid) == first], PATIENCE)
    second, _ = system.begin(client, hour)
    assert system.result(client, first)[:2] == (Status.ABORTED, -1)
    assert client.cancel(second)[1] == [second]
    assert system.result(client, second)[:2] == (Status.CANCELED, -1)


@pytest.mark.parametrize("victim", ["router", "bridge", "daemon"])
def test_each_accepted_goal_has_one_result_over_kills(system: System, victim: str) -> None:
    assert kill(system, victim) in (("canceled",) if victim in GOES_ON else ("aborted", "lost"))
