"""Messages to bytes and back, and bytes that are none."""

import contextlib
import math
import struct
import tracemalloc

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hyperbit.controller.ros2.wire.cdr import HEADER, MOST_BYTES, BadMessage, deserialize, message, serialize
from hyperbit.controller.ros2.wire.types import Types, UnknownType

TYPES = {name: Types(name) for name in ("jazzy", "kilted")}
JAZZY = TYPES["jazzy"]
JOINTS = "sensor_msgs/msg/JointState"
FOLLOW = "control_msgs/action/FollowJointTrajectory"
MESSAGES = sorted(
    name
    for name in JAZZY.store.fielddefs
    if name in JAZZY.hashes or name.rsplit("_", 1)[0] in JAZZY.hashes or name.startswith(FOLLOW)
)
POINTS = [{"positions": [1.0, 2.0], "time_from_start": {"sec": 1}}, {"positions": [3.0]}]
TRAJECTORY = {"joint_names": ["a", "bc"], "points": POINTS}
FILLED = {
    JOINTS: {"header": {"frame_id": "base"}, "name": ["a", "bc"], "position": [1.0, math.nan], "effort": [math.inf]},
    f"{FOLLOW}_SendGoal_Request": {"goal_id": {"uuid": bytes(range(16))}, "goal": {"trajectory": TRAJECTORY}},
    "diagnostic_msgs/msg/DiagnosticArray": {"status": [{"name": "x", "values": [{"key": "k", "value": "v"}] * 3}] * 2},
    "visualization_msgs/msg/MarkerArray": {"markers": [{"points": [{"x": 1.0}] * 3, "text": "ä"}]},
    "tf2_msgs/msg/TFMessage": {"transforms": [{"child_frame_id": "tool"}] * 2},
    "nav_msgs/srv/GetPlan_Response": {"plan": {"poses": [{}] * 3}},
    "action_msgs/msg/GoalStatusArray": {"status_list": [{"status": 2}] * 3},
}


@pytest.mark.parametrize("name", MESSAGES)
def test_a_message_is_what_was_sent(name: str) -> None:
    data = serialize(FILLED.get(name, {}), name, JAZZY)
    assert data[:4] == HEADER
    assert serialize(deserialize(data, name, JAZZY), name, JAZZY) == data


def test_joint_states_are_written_by_the_rules_of_cdr() -> None:
    data = serialize(FILLED[JOINTS], JOINTS, JAZZY)
    body = struct.pack("<iII5sxxxII2sxxI3sxII", 0, 0, 5, b"base\0", 2, 2, b"a\0", 3, b"bc\0", 2, 0)[:-4]
    body += bytes(-len(body) % 8) + struct.pack("<dd", 1.0, math.nan)
    body += struct.pack("<II", 0, 1) + struct.pack("<d", math.inf)
    assert data == HEADER + body


def test_an_empty_request_is_one_zero_byte() -> None:
    assert serialize({}, "std_srvs/srv/Trigger_Request", JAZZY) == b"\x00\x01\x00\x00\x00"
    deserialize(b"\x00\x01\x00\x00\x00", "std_srvs/srv/Trigger_Request", JAZZY)


def test_a_quaternion_turns_nothing_unless_it_is_given() -> None:
    assert message({}, "geometry_msgs/msg/PoseStamped", JAZZY).pose.orientation.w == 1.0


@pytest.mark.parametrize("name", MESSAGES)
def test_truncated_bytes_are_refused_or_read(name: str) -> None:
    data = serialize(FILLED.get(name, {}), name, JAZZY)
    for length in range(len(data) - 3):  # up to three bytes behind a message are padding
        with pytest.raises(BadMessage):
            deserialize(data[:length], name, JAZZY)


@given(st.sampled_from(MESSAGES), st.binary(max_size=200))
def test_any_bytes_are_a_message_or_refused(name: str, data: bytes) -> None:
    try:
        deserialize(HEADER + data, name, JAZZY)
    except BadMessage:
        return
    assert len(data) > 0


@given(st.sampled_from(sorted(FILLED)), st.data())
def test_a_message_with_changed_bytes_is_a_message_or_refused(name: str, data: st.DataObject) -> None:
    """Lengths become large, texts become other bytes."""
    changed = bytearray(serialize(FILLED[name], name, JAZZY))
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
        ("std_msgs/msg/String", b""),
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
    data = serialize({"data": "x" * MOST_BYTES}, "std_msgs/msg/String", JAZZY)
    with pytest.raises(BadMessage, match="at most 1000000"):
        deserialize(data, "std_msgs/msg/String", JAZZY)


@pytest.mark.parametrize("header", [b"\x00\x07\x00\x00", b"\x00\x03\x00\x00", b"\x01\x00\x00\x00", b"abcd", b""])
def test_other_headers_are_refused(header: bytes) -> None:
    with pytest.raises(BadMessage, match="CDR"):
        deserialize(header + struct.pack("<I", 1) + b"\0", "std_msgs/msg/String", JAZZY)


def test_big_endian_is_read() -> None:
    data = b"\x00\x00\x00\x00" + struct.pack(">I", 3) + b"ab\0"
    assert deserialize(data, "std_msgs/msg/String", JAZZY).data == "ab"


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


def test_a_message_of_another_type_is_refused() -> None:
    other = message({}, "std_msgs/msg/String", JAZZY)
    with pytest.raises(BadMessage, match="expected a message sensor_msgs/msg/JointState"):
        serialize(other, JOINTS, JAZZY)


def test_unknown_types_are_refused() -> None:
    for call in (lambda: serialize({}, "a/msg/B", JAZZY), lambda: deserialize(HEADER, "a/msg/B", JAZZY)):
        with pytest.raises(UnknownType, match="a/msg/B"):
            call()


def test_messages_nest() -> None:
    point = message({"x": 1.0}, "geometry_msgs/msg/Point", JAZZY)
    pose = message({"pose": {"position": point}}, "geometry_msgs/msg/PoseStamped", JAZZY)
    assert deserialize(serialize(pose, "geometry_msgs/msg/PoseStamped", JAZZY), "geometry_msgs/msg/PoseStamped", JAZZY)
    assert pose.pose.position.x == 1.0
    assert isinstance(message({"position": [1]}, JOINTS, JAZZY).position, np.ndarray)
