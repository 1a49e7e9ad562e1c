"""Messages to bytes and back: exact bytes, and bytes that are no message."""

import contextlib
import math
import struct
import tracemalloc
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hyperbit.controller.ros2.wire.cdr import HEADER, MOST_BYTES, BadMessage, deserialize, message, serialize
from hyperbit.controller.ros2.wire.types import Types, UnknownType

JAZZY = Types("jazzy")
JOINTS, STRING, POSE = "sensor_msgs/msg/JointState", "std_msgs/msg/String", "geometry_msgs/msg/PoseStamped"
FOLLOW = "control_msgs/action/FollowJointTrajectory"
MESSAGES = sorted(
    name
    for name in JAZZY.store.fielddefs
    if name in JAZZY.hashes or name.rsplit("_", 1)[0] in JAZZY.hashes or name.startswith(FOLLOW)
)
UUID = "00010203 04050607 08090a0b 0c0d0e0f"
GOAL = {"uuid": bytes(range(16))}
POINT = {"positions": [0.5], "time_from_start": {"sec": 1}}
JOINT = "01000000 03000000 6a310000"  # of the name j1
HALF = "00000000 0000e03f"
# Type, fields, and the bytes behind the header, by the rules of CDR: each number is at a multiple of its size.
EXACT: list[tuple[str, dict[str, Any], str]] = [
    (STRING, {"data": "ab"}, "03000000 616200"),
    ("std_srvs/srv/Trigger_Request", {}, "00"),
    ("std_srvs/srv/Trigger_Response", {"success": True, "message": "ok"}, "01 000000 03000000 6f6b00"),
    (
        JOINTS,
        {"header": {"frame_id": "base"}, "name": ["a", "bc"], "position": [1.0, math.nan], "effort": [math.inf]},
        "00000000 00000000 05000000 62617365 00 000000 02000000 02000000 6100 0000 03000000 626300 00 02000000 00000000"
        "00000000 0000f03f 00000000 0000f87f 00000000 01000000 00000000 0000f07f",
    ),
    (
        f"{FOLLOW}_SendGoal_Request",
        {"goal_id": GOAL, "goal": {"trajectory": {"joint_names": ["j1"], "points": [POINT]}}},
        f"{UUID} 00000000 00000000 01000000 00000000 {JOINT} 01000000 01000000 00000000 {HALF}"
        f"{'00000000' * 3} 01000000 {'00000000' * 3} 01000000 {'00000000' * 9}",
    ),
    (
        "action_msgs/srv/CancelGoal_Response",
        {"return_code": 3, "goals_canceling": [{"goal_id": GOAL, "stamp": {"sec": 1}}]},
        f"03 000000 01000000 {UUID} 01000000 00000000",
    ),
    (
        f"{FOLLOW}_FeedbackMessage",
        {"goal_id": GOAL, "feedback": {"joint_names": ["j1"], "desired": {"positions": [0.5]}}},
        f"{UUID} 00000000 00000000 01000000 00000000 {JOINT} 01000000 00000000 0000e03f {'00000000' * 33}",
    ),
]
SOME = {name: fields for name, fields, _ in EXACT} | {
    "tf2_msgs/msg/TFMessage": {"transforms": [{"child_frame_id": "tool"}] * 2},
    "visualization_msgs/msg/MarkerArray": {"markers": [{"points": [{"x": 1.0}] * 3, "text": "ä"}]},
    "diagnostic_msgs/msg/DiagnosticArray": {"status": [{"name": "x", "values": [{"key": "k", "value": "v"}] * 3}] * 2},
    "action_msgs/msg/GoalStatusArray": {"status_list": [{"goal_info": {"goal_id": GOAL}, "status": 2}]},
    "nav_msgs/srv/GetPlan_Response": {"plan": {"poses": [{}] * 3}},
}


@pytest.mark.parametrize(("name", "fields", "expected"), EXACT, ids=[name for name, _, _ in EXACT])
def test_messages_have_exactly_these_bytes(name: str, fields: dict[str, Any], expected: str) -> None:
    assert serialize(fields, name, JAZZY).hex(" ", 4) == (HEADER + bytes.fromhex(expected)).hex(" ", 4)


@pytest.mark.parametrize("name", MESSAGES)
def test_a_message_is_what_was_sent_and_part_of_it_is_none(name: str) -> None:
    data = serialize(SOME.get(name, {}), name, JAZZY)
    assert serialize(deserialize(data, name, JAZZY), name, JAZZY) == data
    for length in range(len(data) - 3):  # up to three bytes behind a message are padding
        with pytest.raises(BadMessage):
            deserialize(data[:length], name, JAZZY)


@given(st.sampled_from(sorted(SOME)), st.data())
def test_a_message_with_changed_bytes_is_a_message_or_refused(name: str, data: st.DataObject) -> None:
    """Lengths become large, texts become other bytes."""
    changed = bytearray(serialize(SOME[name], name, JAZZY)) + bytes(4)
    for _ in range(data.draw(st.integers(1, 3))):
        at = data.draw(st.integers(4, len(changed) - 4))
        changed[at : at + 4] = data.draw(
            st.sampled_from([b"\xff\xff\xff\xff", b"\xff\xff\xff\x7f", bytes(4), b"\x80" * 4])
        )
    with contextlib.suppress(BadMessage):  # both outcomes are right, another error is not
        assert deserialize(bytes(changed), name, JAZZY) is not None


@pytest.mark.parametrize("size", [2**32 - 1, 2**31, 2**20])
@pytest.mark.parametrize(
    ("name", "before"),
    [
        (STRING, b""),
        (JOINTS, bytes(8) + struct.pack("<I", 1) + bytes(4)),
        ("tf2_msgs/msg/TFMessage", b""),
        ("action_msgs/msg/GoalStatusArray", b""),
    ],
)
def test_a_forged_length_allocates_nothing(name: str, before: bytes, size: int) -> None:
    data = HEADER + before + struct.pack("<I", size) + bytes(64)
    with pytest.raises(BadMessage):  # so that the code for this type exists
        deserialize(data, name, JAZZY)
    tracemalloc.start()
    try:
        with pytest.raises(BadMessage):
            deserialize(data, name, JAZZY)
        assert tracemalloc.get_traced_memory()[1] < 100_000
    finally:
        tracemalloc.stop()


def test_too_many_bytes_are_refused() -> None:
    data = serialize({"data": "x" * MOST_BYTES}, STRING, JAZZY)
    with pytest.raises(BadMessage, match="at most 1000000"):
        deserialize(data, STRING, JAZZY)


@pytest.mark.parametrize("header", [b"\x00\x07\x00\x00", b"\x00\x03\x00\x00", b"\x01\x00\x00\x00", b"abcd", b""])
def test_other_headers_are_refused(header: bytes) -> None:
    with pytest.raises(BadMessage, match="CDR"):
        deserialize(header + struct.pack("<I", 1) + b"\0", STRING, JAZZY)


def test_big_endian_is_read() -> None:
    data = b"\x00\x00\x00\x00" + struct.pack(">I", 3) + b"ab\0"
    assert deserialize(data, STRING, JAZZY).data == "ab"


@pytest.mark.parametrize(
    ("fields", "why"),
    [
        ({"x": 1}, "has no field 'x'"),
        ({"position": "abc"}, "position"),
        ({"position": [1, "b"]}, "position"),
        ({"header": 3}, "no sensor_msgs/msg/JointState"),
        ({"header": {"stamp": {"sec": 2**40}}}, "no sensor_msgs/msg/JointState"),
        ({"header": {"frame_id": 3}}, "no sensor_msgs/msg/JointState"),
        ({"name": [3]}, "no sensor_msgs/msg/JointState"),
        ({"name": 3}, "name"),
        ({"name": ["\ud800"]}, "no sensor_msgs/msg/JointState"),
    ],
)
def test_values_that_do_not_fit_are_refused(fields: dict[str, object], why: str) -> None:
    with pytest.raises(BadMessage, match=why):
        serialize(fields, JOINTS, JAZZY)


def test_messages_of_another_or_an_unknown_type_are_refused() -> None:
    with pytest.raises(BadMessage, match="expected a message sensor_msgs/msg/JointState"):
        serialize(message({}, STRING, JAZZY), JOINTS, JAZZY)
    for call in (lambda: serialize({}, "a/msg/B", JAZZY), lambda: deserialize(HEADER, "a/msg/B", JAZZY)):
        with pytest.raises(UnknownType, match="a/msg/B"):
            call()


def test_messages_nest() -> None:
    point = message({"x": 1.0}, "geometry_msgs/msg/Point", JAZZY)
    pose = message({"pose": {"position": point}}, POSE, JAZZY)
    assert deserialize(serialize(pose, POSE, JAZZY), POSE, JAZZY).pose.position.x == 1.0
    assert pose.pose.orientation.w == 1.0, "it turns nothing unless it is given"
    assert isinstance(message({"position": [1]}, JOINTS, JAZZY).position, np.ndarray)
