"""An independent reader of the bridge's inputs: it decides whether a message may move the arm."""

import math
import struct
from typing import Any, NamedTuple

MOST_BYTES = 1_000_000
STAMP_LIMIT = 5.0  # [s]
MOST_POINTS = 10_000
Goal = list[Any]


class Invalid(Exception):
    """A message is none, or breaks a rule."""


class Arm(NamedTuple):
    """What the rules depend on.

    Attributes:
        frames: allowed names of frames; the base of the arm is the world's origin.
        oriented: whether the orientation of topics counts.
    """

    frames: tuple[str, ...]
    axes: tuple[str, ...]
    actuators: tuple[str, ...]
    oriented: bool


class Reader:
    """Reads CDR of either byte order."""

    def __init__(self, message: bytes) -> None:
        if len(message) > MOST_BYTES or message[:2] not in (b"\0\0", b"\0\1"):
            raise Invalid("size or header")
        self.order, self.data, self.at = "<" if message[1] else ">", message[4:], 0

    def get(self, form: str, count: int = 1) -> tuple[Any, ...]:
        size = struct.calcsize(form)
        if count:
            self.at += -self.at % size
        try:
            values = struct.unpack_from(f"{self.order}{count}{form}", self.data, self.at)
        except struct.error as error:
            raise Invalid(str(error)) from None
        self.at += size * count
        return values

    def many(self, form: str) -> tuple[Any, ...]:
        (count,) = self.get("I")
        if count > MOST_BYTES:
            raise Invalid("length")
        return self.get(form, count)

    def text(self) -> str:
        (length,) = self.get("I")
        coded = self.data[self.at : self.at + length]
        if len(coded) < length:
            raise Invalid("length")
        self.at += length
        try:
            return coded[:-1].decode()
        except UnicodeDecodeError:
            raise Invalid("text") from None

    def stamp(self) -> float:
        (seconds,), (nanoseconds,) = self.get("i"), self.get("I")
        return float(seconds + nanoseconds / 1e9)

    def header(self) -> tuple[float, str]:
        return self.stamp(), self.text()

    def count(self) -> int:
        (count,) = self.get("I")
        if count > len(self.data):
            raise Invalid("length")
        return int(count)


def check_attachment(data: bytes | None) -> None:
    """Raises Invalid if these bytes are no attachment."""
    if data is None or len(data) != 33 or data[16] != 16 or min(struct.unpack_from("<qq", data)) < 0:
        raise Invalid("attachment")


def check_frame(name: str, arm: Arm) -> None:
    if name not in ("", *arm.frames):
        raise Invalid("frame")


def check_stamp(stamp: float, now: float) -> None:
    """Raises Invalid if a stamp is neither 0 nor near."""
    if stamp != 0 and abs(now - stamp) > STAMP_LIMIT:
        raise Invalid("stamp")


def read_pose(reader: Reader, arm: Arm, *, oriented: bool) -> tuple[float, list[float]]:
    """Returns stamp and position of a PoseStamped."""
    stamp, frame = reader.header()
    check_frame(frame, arm)
    numbers = reader.get("d", 7)
    if not all(map(math.isfinite, numbers[: 7 if oriented else 3])):
        raise Invalid("number")
    if oriented and abs(math.hypot(*numbers[3:]) - 1) > 0.01:
        raise Invalid("quaternion")
    return stamp, list(numbers[: len(arm.axes)])


def goal_of(kind: str, message: bytes, arm: Arm, now: float) -> Goal:
    """Returns the positions, one a waypoint, to which a message of this kind may move the arm.

    Args:
        kind: goal_pose, goal_path, setpoint, plan, tip or actuators.
        now: UNIX time [s].

    Raises:
        Invalid: the message may not move the arm.
    """
    reader = Reader(message)
    if kind in ("goal_pose", "setpoint"):
        stamp, position = read_pose(reader, arm, oriented=arm.oriented and kind == "goal_pose")
        if kind == "goal_pose":
            check_stamp(stamp, now)
        return [position]
    if kind == "plan":
        reader.header(), reader.get("d", 7)  # a plan begins where the arm is
        return [read_pose(reader, arm, oriented=arm.oriented)[1]]
    if kind == "goal_path":
        stamp, frame = reader.header()
        check_frame(frame, arm)
        check_stamp(stamp, now)
        poses = [read_pose(reader, arm, oriented=arm.oriented) for _ in range(reader.count())]
        if not 1 <= len(poses) <= MOST_POINTS:
            raise Invalid("poses")
        check_stamp(poses[0][0], now)
        return [position for _, position in poses]
    return trajectory(reader, arm, tip=kind == "tip")


def trajectory(reader: Reader, arm: Arm, *, tip: bool) -> Goal:
    reader.get("B", 16)
    _, frame = reader.header()
    joints = [reader.text() for _ in range(reader.count())]
    points = []
    for _ in range(reader.count()):
        points.append(reader.many("d"))
        for _ in range(3):
            reader.many("d")
        reader.stamp()
    if tip:
        check_frame(frame, arm)
    if len(set(joints)) < len(joints) or not 1 <= len(points) <= MOST_POINTS:
        raise Invalid("joints or points")
    allowed = set(joints) - {"tip_yaw"} == set(arm.axes) if tip else set(joints) <= set(arm.actuators)
    if not allowed:
        raise Invalid("joints")
    for point in points:
        if len(point) != len(joints) or not all(map(math.isfinite, point)):
            raise Invalid("positions")
        if not tip and any(min(abs(value), abs(value - 1)) > 0.01 + 1e-12 for value in point):
            raise Invalid("state")
    if not tip:
        return points
    return [[point[joints.index(axis)] for axis in arm.axes] for point in points]


def end_limit(reader: Reader) -> tuple[float, float | None]:
    """Returns stamp of a trajectory, and by how long after it its goal is to end [s]; None: it may take any time."""
    reader.get("B", 16)
    stamp, _ = reader.header()
    [reader.text() for _ in range(reader.count())]
    last = 0.0
    for _ in range(reader.count()):
        for _ in range(4):
            reader.many("d")
        last = reader.stamp()
    reader.header()
    [reader.text() for _ in range(reader.count())]
    if reader.count():
        raise Invalid("joints of several degrees of freedom")
    for _ in range(2):  # tolerances of the path, and of the goal
        for component in (False, True):
            for _ in range(reader.count()):
                reader.text()
                reader.get("H", component)
                reader.get("d", 3)
    allowed = reader.stamp()
    return stamp, last + allowed if allowed > 0 else None
