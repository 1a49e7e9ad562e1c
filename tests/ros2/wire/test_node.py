"""What a node tells of others that do not fit it."""

from collections.abc import Callable

from hyperbit.controller.ros2.wire.node import Node
from hyperbit.controller.ros2.wire.session import Session
from tests.waiting import eventually

STRING, POSE, TRIGGER = "std_msgs/msg/String", "geometry_msgs/msg/PoseStamped", "std_srvs/srv/Trigger"
FOLLOW = "control_msgs/action/FollowJointTrajectory"
Connect = Callable[[], Session]


def watched(session: Session) -> tuple[Node, list[str]]:
    node, told = Node(session, "bridge", "/arm"), list[str]()
    node.publisher("chatter", STRING)
    node.subscriber("goal", POSE, lambda received: None)
    node.service("trigger", TRIGGER, lambda request: request.reply({}))
    node.client("other", TRIGGER)
    node.watch(told.append)
    return node, told


def test_endpoints_of_another_type_or_hash_are_told(connect: Connect) -> None:
    other = Node(connect(), "rviz", "/there")
    other.publisher("/arm/goal", STRING)  # before the node watches
    node, told = watched(connect())
    other.subscriber("/arm/chatter", POSE, lambda received: None)
    other.client("/arm/trigger", "nav_msgs/srv/GetPlan")
    other.service("/arm/other", "nav_msgs/srv/GetPlan", lambda request: None)
    eventually(lambda: len(told) == 4)
    assert {it.split(":")[0] for it in told} == {"/arm/goal", "/arm/chatter", "/arm/trigger", "/arm/other"}
    (goal,) = (it for it in told if it.startswith("/arm/goal"))
    assert "no messages are exchanged with '/there/rviz'" in goal
    assert f"std_msgs::msg::dds_::String_/{node.types.hash(STRING)}" in goal
    assert f"expected 'geometry_msgs::msg::dds_::PoseStamped_/{node.types.hash(POSE)}" in goal


def test_a_hash_of_another_distribution_is_told(connect: Connect) -> None:
    node, told = watched(connect())
    node.action_server("follow", FOLLOW, lambda goal: goal.reject())
    peer = Node(connect(), "peer", distro="kilted")
    peer.subscriber("/arm/follow/_action/feedback", f"{FOLLOW}_FeedbackMessage", lambda received: None)
    eventually(lambda: told)
    assert peer.types.hash(f"{FOLLOW}_FeedbackMessage") in told[0]


def test_what_fits_is_not_told_and_a_second_node_of_the_name_is(connect: Connect) -> None:
    _, told = watched(connect())
    friend = Node(connect(), "friend", "/arm")
    friend.publisher("goal", POSE)
    friend.subscriber("chatter", STRING, lambda received: None)
    friend.publisher("chatter", POSE)  # two publishers exchange nothing
    friend.client("trigger", TRIGGER)
    strange = connect().zenoh
    tokens = [strange.liveliness().declare_token(f"@ros2_lv/0/{it}") for it in ("x", "1/2/3/NN/%/%arm/bridge/4")]
    Node(connect(), "bridge", "/arm")
    eventually(lambda: len(told) == len(tokens))  # the node, and the token with a part more
    assert set(told) == {"another node /arm/bridge is there: end one of both, or rename it"}


def test_a_closed_node_tells_nothing(connect: Connect) -> None:
    node, told = watched(connect())
    _, later = watched(connect())
    eventually(lambda: told and later)  # they have one name
    node.close()
    told.clear()
    other = Node(connect(), "bridge", "/arm")
    eventually(lambda: len(later) == 2)
    assert told == []
    other.close()
