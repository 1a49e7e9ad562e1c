"""An action client of FollowJointTrajectory that uses nothing of controller/ros2: keys and bytes are written out."""

import struct
import threading
import time
import uuid
from collections.abc import Sequence
from typing import Any, NamedTuple

import zenoh
import zenoh.ext

TYPE = "control_msgs::action::dds_::FollowJointTrajectory"
SEND_GOAL = f"{TYPE}_SendGoal_/RIHS01_b13789dddc325a7a962825c45e28c77d37237ec129dd0c34dc5994562938c57f"
GET_RESULT = f"{TYPE}_GetResult_/RIHS01_e3ceb38e3e1867c8dc0f46014df26e90eb93422f27e9e97f936e07f94be4bc8b"
CANCEL = "action_msgs::srv::dds_::CancelGoal_/RIHS01_573d8b0a534451d7bc2ac8c5ffde8ac14b8593b7001175d0cd6516dcbeb8689a"
FEEDBACK = {  # by distribution
    "jazzy": f"{TYPE}_FeedbackMessage_/RIHS01_80398fcb9674a79081a9906e2ccf0c804dd7cb15e22e362e606ee87186beab71",
    "kilted": f"{TYPE}_FeedbackMessage_/RIHS01_95618cc73912d99b9acaa17d2da5e832cb0bfdeede7534fa8ec600feca2a6c4b",
}
STATUS = (
    "action_msgs::msg::dds_::GoalStatusArray_/RIHS01_6c1684b00f177d37438febe6e709fc4e2b0d4248dca4854946f9ed8b30cda83e"
)
ACCEPTED, EXECUTING, CANCELING, SUCCEEDED, CANCELED, ABORTED = range(1, 7)
HEADER = b"\x00\x01\x00\x00"
GID = bytes(range(16))
PATIENCE = 60.0  # [s]


class Bytes:
    """Writes CDR, little endian; alignment counts from after the header."""

    def __init__(self) -> None:
        self.data = bytearray()

    def put(self, form: str, *values: Any) -> "Bytes":
        for value in values:
            self.data += bytes(-len(self.data) % struct.calcsize(form)) + struct.pack(f"<{form}", value)
        return self

    def text(self, value: str) -> "Bytes":
        coded = value.encode() + b"\0"
        self.put("I", len(coded))
        self.data += coded
        return self

    def message(self) -> bytes:
        return HEADER + bytes(self.data)


class Reading:
    """Reads CDR, little endian."""

    def __init__(self, message: bytes) -> None:
        assert message[:4] == HEADER
        self.data, self.at = message[4:], 0

    def get(self, form: str) -> Any:
        size = struct.calcsize(form)
        self.at += -self.at % size
        (value,) = struct.unpack_from(f"<{form}", self.data, self.at)
        self.at += size
        return value

    def raw(self, size: int) -> bytes:
        self.at += size
        return self.data[self.at - size : self.at]

    def text(self) -> str:
        return self.raw(self.get("I"))[:-1].decode()


class Result(NamedTuple):
    status: int
    error_code: int
    error_string: str


class Canceled(NamedTuple):
    code: int
    goals: list[bytes]


def trajectory(joints: Sequence[str], points: Sequence[Sequence[float]], step: float = 1.0) -> bytes:
    out = Bytes().put("i", 0).put("I", 0).text("").put("I", len(joints))
    for joint in joints:
        out.text(joint)
    out.put("I", len(points))
    for k, positions in enumerate(points, 1):
        nanoseconds = round(k * step * 1e9)
        out.put("I", len(positions)).put("d", *positions).put("I", 0, 0, 0)
        out.put("i", nanoseconds // 10**9).put("I", nanoseconds % 10**9)
    out.put("i", 0).put("I", 0).text("").put("I", 0, 0)  # the trajectory of joints with several degrees of freedom
    out.put("I", 0, 0, 0, 0)  # tolerances
    return bytes(out.put("i", 0).put("I", 0).data)


class Client:
    """Drives the action `action` of domain 0."""

    def __init__(self, session: zenoh.Session, action: str, distro: str = "jazzy") -> None:
        self.session, self.base = session, f"0/{action}/_action"
        self.sequence = 0
        self.feedback: list[tuple[bytes, str]] = []
        self.states: list[list[tuple[bytes, int]]] = []
        self.lock = threading.Lock()
        session.declare_subscriber(f"{self.base}/feedback/{FEEDBACK[distro]}", self.on_feedback)
        zenoh.ext.declare_advanced_subscriber(
            session,
            f"{self.base}/status/{STATUS}",
            self.on_status,
            history=zenoh.ext.HistoryConfig(detect_late_publishers=True, max_samples=1),
        )

    def on_feedback(self, sample: zenoh.Sample) -> None:
        assert len(sample.attachment.to_bytes()) == 33
        data = Reading(sample.payload.to_bytes())
        goal = data.raw(16)
        data.get("i"), data.get("I"), data.text()
        joints = [data.text() for _ in range(data.get("I"))]
        self.feedback.append((goal, joints[0]))

    def on_status(self, sample: zenoh.Sample) -> None:
        data = Reading(sample.payload.to_bytes())
        self.states.append(
            [(data.raw(16), (data.get("i"), data.get("I"), data.get("b"))[2]) for _ in range(data.get("I"))]
        )

    def call(self, key: str, payload: bytes, timeout: float = PATIENCE) -> Reading | None:
        with self.lock:
            self.sequence += 1
            sequence = self.sequence
        replies = self.session.get(
            f"{self.base}/{key}",
            payload=payload,
            attachment=struct.pack("<qqB", sequence, time.time_ns(), 16) + GID,
            target=zenoh.QueryTarget.ALL_COMPLETE,
            consolidation=zenoh.ConsolidationMode.NONE,
            timeout=timeout,
        )
        for reply in replies:
            if reply.ok is None:  # nobody answered in time: a patient client asks again
                assert reply.err.payload.to_string() == "Timeout"
                return None
            attachment = reply.ok.attachment.to_bytes()
            assert len(attachment) == 33
            assert struct.unpack_from("<q", attachment)[0] == sequence
            assert attachment[17:] == GID
            return Reading(reply.ok.payload.to_bytes())
        return None

    def send_goal(self, goal: bytes | None = None, joint: str = "joint1") -> tuple[bytes, bool, int]:
        """Returns the goal's id, whether it was accepted, and the seconds of its stamp."""
        goal = goal or uuid.uuid4().bytes
        answer = self.send(goal, trajectory([joint], [[0.5], [1.0]]))
        assert answer
        return goal, *answer

    def send(self, goal: bytes, fields: bytes) -> tuple[bool, int] | None:
        """Sends a goal; returns whether it was accepted, and the seconds of its stamp; None if there is no answer."""
        answer = self.call(f"send_goal/{SEND_GOAL}", HEADER + goal + fields)
        return (bool(answer.get("B")), answer.get("i")) if answer else None

    def cancel(self, goal: bytes = bytes(16), sec: int = 0, nanosec: int = 0) -> Canceled:
        payload = HEADER + goal + struct.pack("<iI", sec, nanosec)
        answer = self.call(f"cancel_goal/{CANCEL}", payload)
        assert answer
        code, goals = answer.get("b"), []
        for _ in range(answer.get("I")):
            goals.append(answer.raw(16))
            answer.get("i"), answer.get("I")
        return Canceled(code, goals)

    def get_result(self, goal: bytes) -> Result | None:
        """Waits for the result; None if the service did not answer."""
        answer = self.call(f"get_result/{GET_RESULT}", HEADER + goal)
        return Result(answer.get("b"), answer.get("i"), answer.text()) if answer else None
