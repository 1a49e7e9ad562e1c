"""Forms of a daemon's messages as clients read them. Any Zenoh client may publish on a daemon's keys."""

import logging
import time
from collections.abc import Callable
from typing import Annotated, Any, Literal

from msgspec import NODEFAULT, UNSET, Meta, Struct, UnsetType, structs

from hyperbit.controller.decoding.decoding import convert, decode

Message = dict[str, Any]

log = logging.getLogger(__name__)

TELL_EVERY = 60.0  # [s] between two lines of the log on messages that cannot be read
Number = Annotated[float, Meta(ge=-1e9, le=1e9)]
Count = Annotated[int, Meta(ge=-(2**53), le=2**53)]
Stamp = Annotated[float, Meta(ge=0, lt=1e11)]  # [UNIX s]
Angle = Number | Annotated[list[Number], Meta(min_length=4, max_length=4)]  # [rad], or a quaternion x, y, z, w
Position = Annotated[list[Number], Meta(min_length=2, max_length=3)]
ActuatorState = Annotated[int, Meta(ge=0, le=1)] | None  # None: unknown


class Fault(Struct):
    code: str
    message: str
    source: str


class TipPose(Struct):
    position: Position
    orientation: Angle | None = None


class Target(Struct):
    position: Position | None = None
    orientation: Angle | None = None


class Lock(Struct):
    actuator: str
    state: ActuatorState


class Progress(Struct):
    """Of the running goal."""

    waypoints: Count
    reached: Count
    ends: Stamp


class State(Struct):
    mode: str
    reason: str = ""
    stamp: Stamp = 0.0
    simulated: bool = False
    faults: Annotated[list[Fault], Meta(max_length=10_000)] = []  # msgspec copies it
    commanded: list[ActuatorState] | None = None
    measured: list[ActuatorState] | None = None
    configuration: str | None = None
    tip: TipPose | None = None
    target: Target | None = None
    bias: list[Number] | None = None
    goal: str | None = None
    progress: Progress | None = None
    degraded: list[Lock] = []

    def __post_init__(self) -> None:
        if self.commanded is not None and self.measured is not None and len(self.commanded) != len(self.measured):
            raise ValueError(f"{len(self.commanded)} states are commanded, {len(self.measured)} are measured")


class WorstCase(Struct):
    load: Number


class Bus(Struct):
    name: str
    state: str
    load: Number
    worst_case: WorstCase
    tx_frames: Count
    rx_frames: Count
    dropped: Count
    tx_errors: Count
    rx_errors: Count


class Board(Struct):
    bus: str
    node: Count
    state: str
    emergency: str | None
    heartbeat_age: Number | None = None


class LoopTimes(Struct):
    """Of the executor's loop [s]. There are none without an executor."""

    late_p50: Number | UnsetType = UNSET
    late_p99: Number | UnsetType = UNSET
    late_worst: Number | UnsetType = UNSET
    longest_period: Number | UnsetType = UNSET
    mean_work: Number | UnsetType = UNSET
    longest_work: Number | UnsetType = UNSET
    overruns: Number | UnsetType = UNSET


class SetpointCounts(Struct):
    received: Count = 0
    refused: Count = 0
    last_refusal: str | None = None


class Diagnostics(Struct):
    buses: list[Bus] = []
    boards: list[Board] = []
    loop: LoopTimes | UnsetType = UNSET
    counts: list[Count] | UnsetType = UNSET
    queues: dict[str, Count] | UnsetType = UNSET
    setpoint: SetpointCounts | UnsetType = UNSET
    switches: Count = 0
    ledger: str = ""
    waits: Count | UnsetType = UNSET


class Answer(Struct):
    """An answer to a request, except to `arm`."""

    accepted: bool
    message: str
    code: Count = 0
    reason: str | None = None
    id: str | None = None


class Feedback(Struct):
    id: str | None = None
    waypoint: Count | None = None
    waypoints: Count | None = None
    configuration: str | None = None
    error: Number | None = None
    orientation_error: Number | None = None
    switches: Count = 0


class Travel(Struct):
    actuator: str
    state: str
    seconds: Number


class Result(Struct):
    status: str
    id: str | None = None
    code: Count = -1
    message: str = ""
    position: list[Number] | None = None
    error: Number | None = None
    orientation_error: Number | None = None
    switches: Count = 0
    certificate: str | None = None
    travels: list[Travel] = []
    repeated: bool = False


class Note(Struct):
    """A request that the daemon has answered, as `@request` tells."""

    key: str
    answer: Answer
    stamp: Stamp = 0.0


class Timeline(Struct):
    """Of a replay."""

    at: Stamp
    end: Stamp
    begin: Stamp = 0.0
    speed: Number = 1.0
    paused: bool = False


class SavedWaypoint(Struct):
    configuration: str | UnsetType = UNSET
    position: Position | UnsetType = UNSET
    orientation: Angle | None = None


class SavedGoal(Struct):
    waypoints: list[SavedWaypoint] = []


class Pose(Struct):
    name: str
    goal: SavedGoal


class Region(Struct):
    """An obstacle."""

    name: str | None = None
    disc: dict[str, Any] | None = None
    sphere: dict[str, Any] | None = None
    box: dict[str, Any] | None = None
    half_plane: dict[str, Any] | None = None
    half_space: dict[str, Any] | None = None


class WiredActuator(Struct):
    module: int
    actuator: str


class ArmFile(Struct):
    name: str
    text: str
    sha256: str = ""
    tables: dict[str, str] = {}


class Density(Struct):
    """The reach of an arm: `shape` is that of pixels (z, y, x), `values` are compressed shades."""

    shape: Annotated[list[Annotated[int, Meta(ge=1, le=10_000)]], Meta(min_length=3, max_length=3)]
    values: str
    greatest: Number
    first: Annotated[list[Number], Meta(min_length=3, max_length=3)]
    pixel: Number


class Driver(Struct):
    """The daemon of an arm."""

    host: str | None = None


class Description(Struct):
    """An answer to `arm`. Its `drawing` has no form here: who draws the arm builds the chain from it."""

    name: str = ""
    version: str | None = None
    dimension: Literal[2, 3] = 2
    unit: str | None = None
    actuators: list[str] = []
    poses: list[Pose] = []
    obstacles: list[Region] = []
    sent_obstacles: list[Region] = []
    boards: list[WiredActuator] = []
    daemon: Driver | None = None
    file: ArmFile | None = None
    density: Density | None = None
    running: dict[str, Any] | UnsetType | None = UNSET


FORMS: dict[str, type[Struct]] = {
    **{"state": State, "diagnostics": Diagnostics, "feedback": Feedback, "result": Result, "arm": Description},
    **{"request": Note, "timeline": Timeline},
}


def read(key: str, data: bytes, form: type[Struct] | None = None) -> Message:
    """Returns the message in a payload of `key`; unknown fields stay.

    `form` is that of the key; None: that of FORMS. Raises Unreadable if the payload has another form.
    """
    message = decode(data, dict[str, Any])
    if (form := FORMS.get(key) if form is None else form) is not None:
        convert(message, form)
    return message


def filled(key: str, message: Message) -> Message:
    """Returns a message that was read, with the defaults of fields that are absent, as an earlier version sends it."""
    fields = ((field.name, field) for field in structs.fields(FORMS[key]) if field.name not in message)
    made = {name: field.default_factory() if field.default is NODEFAULT else field.default for name, field in fields}
    return {**{name: value for name, value in made.items() if value is not UNSET}, **message}


class UnreadCount:
    """Counts messages that cannot be read. Logs the first, and their number once a minute. For any thread."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock, self._tell_at, self.count = clock, -float("inf"), 0

    def add(self, arm: str, key: str, error: Exception) -> None:
        self.count += 1
        if (now := self._clock()) >= self._tell_at:
            self._tell_at = now + TELL_EVERY
            log.warning("arm %s: %s cannot be read: %.200s (%d such messages so far)", arm, key, error, self.count)
