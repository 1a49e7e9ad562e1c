"""Publishers, subscribers, services and the session, over a router."""

import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import Any

import pytest
import zenoh

from hyperbit.controller.ros2.wire import qos
from hyperbit.controller.ros2.wire.attachments import Attachment
from hyperbit.controller.ros2.wire.cdr import HEADER, MOST_BYTES, deserialize
from hyperbit.controller.ros2.wire.endpoints import MOST_OPEN, NoReply, Received, Request
from hyperbit.controller.ros2.wire.node import Node
from hyperbit.controller.ros2.wire.session import NoRouter, Session
from hyperbit.controller.ros2.wire.tokens import Kind
from hyperbit.controller.ros2.wire.types import Types
from tests.waiting import PATIENCE, eventually

STRING, TRIGGER, JOINTS = "std_msgs/msg/String", "std_srvs/srv/Trigger", "sensor_msgs/msg/JointState"
GID = bytes(range(16))
Connect = Callable[[], Session]


def key(node: Node, name: str, type_name: str = STRING) -> str:
    mangled = type_name.replace("/", "::").replace("::msg::", "::msg::dds_::").replace("::srv::", "::srv::dds_::") + "_"
    return f"0/{name}/{mangled}/{node.types.hash(type_name)}"


def published(publisher: Any, got: list[Received], data: str) -> Received:
    assert eventually(lambda: (publisher.publish({"data": data}), [it for it in got if it.message.data == data])[1])
    return got[-1]


def test_a_message_is_received_with_its_source(connect: Connect) -> None:
    talker, listener = Node(connect(), "talker", "/arm"), Node(connect(), "listener")
    got: list[Received] = []
    subscriber = listener.subscriber("/arm/chatter", STRING, got.append)
    publisher = talker.publisher("chatter", STRING)
    before = time.time_ns()
    published(publisher, got, "first")
    first = got[0]
    assert first.message.data == "first"
    assert first.gid == publisher.token.gid
    assert before <= first.source_time <= time.time_ns()
    publisher.publish({"data": "next"})
    eventually(lambda: got[-1].message.data == "next")
    assert [it.sequence for it in got] == list(range(got[0].sequence, got[0].sequence + len(got)))
    assert not subscriber.dropped


@pytest.mark.parametrize("depth", [1, 3])
def test_a_late_subscriber_receives_the_last_messages(connect: Connect, depth: int) -> None:
    setting = qos.LATCHED._replace(depth=depth)
    publisher = Node(connect(), "talker").publisher("map", STRING, setting)
    for number in range(5):
        publisher.publish({"data": str(number)})
    got: list[Received] = []
    Node(connect(), "listener").subscriber("map", STRING, got.append, setting)
    eventually(lambda: len(got) >= depth)
    assert [it.message.data for it in got] == ["0", "1", "2", "3", "4"][-depth:]


def test_messages_that_cannot_be_used_are_dropped_and_counted(connect: Connect) -> None:
    node, other = Node(connect(), "listener"), connect().zenoh
    got: list[Received] = []
    subscriber = node.subscriber("chatter", STRING, got.append)
    topic, good = key(node, "chatter"), Attachment(1, 1, GID).data
    end = HEADER + b"\4\0\0\0end\0"
    eventually(lambda: (other.put(topic, end, attachment=good), got)[1])  # the route exists
    got.clear()
    put = partial(other.put, topic, congestion_control=zenoh.CongestionControl.BLOCK)  # so that none is lost
    put(end)
    for attachment in (good[:-1], b"\x0fsequence_number" + good):
        put(end, attachment=attachment)
    for content in (HEADER + bytes(MOST_BYTES), b"", HEADER + b"\xff\xff\xff\xff", HEADER + b"\2\0\0\0\xff\0"):
        put(content, attachment=good)
    put(end, attachment=Attachment(2, 1, GID).data)
    eventually(lambda: any(it.sequence == 2 for it in got))
    assert subscriber.dropped == {"attachment": 3, "size": 1, "content": 3}
    assert node.dropped() == {"/chatter": subscriber.dropped}


def raising(received: object) -> None:
    raise RuntimeError("of the program")


def test_a_callback_that_raises_is_counted_and_called_again(connect: Connect) -> None:
    talker, listener = Node(connect(), "talker"), Node(connect(), "listener")
    subscriber, publisher = listener.subscriber("chatter", STRING, raising), talker.publisher("chatter", STRING)
    eventually(lambda: (publisher.publish({"data": "x"}), subscriber.dropped["callback"] >= 2)[1])


def test_a_service_replies(connect: Connect) -> None:
    def handle(request: Request) -> None:
        request.reply({"success": True, "message": "done"})
        request.reply({"success": False, "message": "twice"})  # is ignored

    service = Node(connect(), "server", "/arm").service("trigger", TRIGGER, handle)
    client = Node(connect(), "client").client("/arm/trigger", TRIGGER)
    first, second = client.call({}, PATIENCE), client.call({}, PATIENCE)
    assert first.message.message == "done"
    assert (first.sequence, second.sequence) == (1, 2)
    assert first.gid == client.token.gid
    assert service.open == 0


def test_a_service_replies_later_without_blocking(connect: Connect) -> None:
    waiting: list[Request] = []
    service = Node(connect(), "server").service("trigger", TRIGGER, waiting.append)
    client = Node(connect(), "client").client("trigger", TRIGGER)
    with ThreadPoolExecutor() as pool:
        calls = [pool.submit(client.call, {}, PATIENCE) for _ in range(3)]
        eventually(lambda: len(waiting) == 3)
        assert service.open == 3
        for request in reversed(waiting):
            request.reply({"message": str(request.received.sequence)})
        got = [call.result() for call in calls]
    assert [it.message.message for it in got] == [str(it.sequence) for it in got]
    assert {it.sequence for it in got} == {1, 2, 3}


def test_only_so_many_requests_are_open(connect: Connect) -> None:
    service = Node(connect(), "server").service("trigger", TRIGGER, lambda request: None)
    session = connect()
    client = Node(session, "client")
    ask = partial(session.zenoh.get, key(client, "trigger", TRIGGER), payload=HEADER + b"\0")
    replies = [ask(attachment=Attachment(n, 1, GID).data) for n in range(MOST_OPEN + 5)]
    eventually(lambda: service.open + service.dropped["open"] == len(replies))
    assert service.open == MOST_OPEN
    service.close()
    assert service.open == 0


def test_requests_that_cannot_be_used_get_an_empty_reply(connect: Connect) -> None:
    node = Node(connect(), "server")
    service = node.service("trigger", TRIGGER, raising)
    other, topic = connect().zenoh, key(node, "trigger", TRIGGER)
    good = Attachment(1, 1, GID).data
    eventually(lambda: other.liveliness().get("@ros2_lv/**").recv())
    assert not [reply for reply in other.get(topic, timeout=PATIENCE, payload=HEADER + b"\0") if reply.ok]
    for payload in (b"", HEADER + b"\0", HEADER + bytes(MOST_BYTES)):
        [reply] = other.get(topic, timeout=PATIENCE, payload=payload, attachment=good)
        assert reply.ok
        assert not deserialize(reply.ok.payload.to_bytes(), f"{TRIGGER}_Response", Types("jazzy")).success
    assert service.dropped == {"attachment": 1, "content": 1, "callback": 1, "size": 1}
    assert service.open == 0


def test_a_call_of_nobody_ends(connect: Connect) -> None:
    with pytest.raises(NoReply, match="0/nobody/"):
        Node(connect(), "client").client("nobody", TRIGGER).call({}, 0.5)


def test_tokens_tell_of_nodes_and_endpoints(connect: Connect) -> None:
    session, other = connect(), connect()
    node = Node(session, "bridge", "/arm", domain=7, enclave="/safe")
    made = [
        node.publisher("joint_states", JOINTS),
        node.subscriber("/goal", STRING, lambda received: None, qos.SENSOR_DATA),
        node.service("~/trigger", TRIGGER, lambda request: None),
        node.client("other", TRIGGER),
    ]
    strange = session.zenoh.liveliness().declare_token("@ros2_lv/7/something/else")  # is left out
    expected = {node.token, *(it.token for it in made)}
    eventually(lambda: set(other.tokens(7)) == expected)
    assert other.tokens(8) == []
    assert {it.kind for it in expected} == set(Kind)
    names = {it.endpoint.name for it in expected if it.endpoint}
    assert names == {"/arm/joint_states", "/goal", "/arm/bridge/trigger", "/arm/other"}
    assert {it.id for it in expected} == {"0", "1", "2", "3", "4"}
    node.close()
    eventually(lambda: other.tokens(7) == [])
    strange.undeclare()


def test_without_a_router_there_is_no_session() -> None:
    with pytest.raises(NoRouter, match=r"no router at 'tcp/127.0.0.1:1' within 0.2 s"):
        Session("tcp/127.0.0.1:1", timeout=0.2)
    with pytest.raises(NoRouter, match="no router at 'nonsense'"):
        Session("nonsense", timeout=0.2)


def test_nothing_happens_on_a_closed_session(connect: Connect) -> None:
    session = connect()
    node = Node(session, "talker")
    publisher, waiting = node.publisher("map", STRING, qos.LATCHED), []
    service = node.service("trigger", TRIGGER, waiting.append)
    other = connect()
    other.zenoh.get(key(node, "trigger", TRIGGER), payload=HEADER + b"\0", attachment=Attachment(1, 1, GID).data)
    eventually(lambda: waiting)
    session.close()
    publisher.publish({"data": "nobody hears"})
    waiting[0].reply({})
    node.close()
    assert service.open == 0


def test_all_is_there_again_after_the_routers_loss(connect: Connect, router: Any) -> None:
    session, other = connect(), connect()
    node = Node(session, "bridge")
    latched = node.publisher("map", STRING, qos.LATCHED)
    latched.publish({"data": "before"})
    publisher, heard = node.publisher("chatter", STRING), []
    node.subscriber("orders", STRING, heard.append)
    node.service("trigger", TRIGGER, lambda request: request.reply({"message": "here"}))
    expected = set(session.tokens())
    router.end()
    eventually(lambda: not session.connected() and not other.connected())
    router.start()
    eventually(lambda: session.connected() and other.connected())
    eventually(lambda: set(other.tokens()) == expected)

    peer, got, late = Node(other, "peer"), [], []
    peer.subscriber("chatter", STRING, got.append)
    peer.subscriber("map", STRING, late.append, qos.LATCHED)
    published(publisher, got, "again")
    eventually(lambda: late)
    assert late[0].message.data == "before"
    assert peer.client("trigger", TRIGGER).call({}, PATIENCE).message.message == "here"
    published(peer.publisher("orders", STRING), heard, "order")


def test_a_zenoh_session_of_the_wire_has_timestamps_and_no_namespace(connect: Connect) -> None:
    got: list[zenoh.Sample] = []
    session = connect().zenoh
    session.declare_subscriber("a", got.append)
    eventually(lambda: (session.put("a", b""), got)[1])
    assert got[0].timestamp is not None
    assert str(got[0].key_expr) == "a"
