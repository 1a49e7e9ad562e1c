"""The messages on `state` and `diagnostics`, and on `timeline` of a replay."""

from typing import Annotated, Any

from msgspec import UNSET, Meta, Struct, UnsetType

from hyperbit.controller.messages.parts import Count, Number, Pose, Stamp

ActuatorState = Annotated[int, Meta(ge=0, le=1)] | None  # 0 contracted, 1 extended, None unknown


class Fault(Struct, frozen=True):
    """An active fault or warning."""

    code: str
    source: str
    message: str


class Lock(Struct, frozen=True):
    """A locked actuator."""

    actuator: str
    state: ActuatorState


class Progress(Struct, frozen=True):
    """Of the running goal or jog."""

    waypoints: Count
    reached: Count
    ends: Stamp  # expected
    begins: Stamp = 0.0


class State(Struct, frozen=True):
    """What the arm does and where it is, up to 20 times a second and on each change."""

    mode: str
    stamp: Stamp = 0.0  # of the measurement
    reason: str = ""
    simulated: bool = False
    configuration: str | None = None  # measured
    measured: list[ActuatorState] | None = None
    tip: Pose | None = None
    commanded: list[ActuatorState] | None = None
    unread: list[str] = []
    homing: list[str] = []
    goal: str | None = None
    waypoint: Count | None = None  # that the arm moves to or holds
    target: Pose | None = None
    progress: Progress | None = None
    obstacles: Count = 0
    faults: Annotated[list[Fault], Meta(max_length=10_000)] = []  # msgspec copies it
    degraded: list[Lock] = []
    bias: list[Number] | UnsetType = UNSET
    poses: Count = 0
    commission: dict[str, Any] | UnsetType = UNSET

    def __post_init__(self) -> None:
        if self.commanded is not None and self.measured is not None and len(self.commanded) != len(self.measured):
            raise ValueError(f"{len(self.commanded)} states are commanded, {len(self.measured)} are measured")


class WorstCase(Struct, frozen=True):
    """The worst-case traffic of an arm on a bus [bit/s]."""

    load: Number  # as a fraction of the bit rate
    heartbeats: Number = 0.0
    sync: Number = 0.0
    rpdos: Number = 0.0
    tpdos: Number = 0.0


class Bus(Struct, frozen=True):
    name: str
    state: str
    tx_frames: Count
    rx_frames: Count
    tx_errors: Count
    rx_errors: Count
    dropped: Count  # frames that could not be sent
    load: Number  # as a fraction of the bit rate
    worst_case: WorstCase
    ignored: Count = 0  # received frames of other kinds
    overruns: Count = 0  # of the controller's buffer
    frames_per_second: Number = 0.0
    bits_per_second: Number = 0.0


class Board(Struct, frozen=True):
    bus: str
    node: Count
    state: str  # of NMT, in words
    emergency: str | None  # the last one, in words
    heartbeat_age: Number | None = None  # [s]
    unverified: Count = 0  # switches and reads whose outputs could not be read back


class LoopTimes(Struct, frozen=True):
    """Of the executor's loop in the last second [s]. There are none without an executor."""

    ticks: Number | UnsetType = UNSET
    longest_period: Number | UnsetType = UNSET
    mean_work: Number | UnsetType = UNSET
    longest_work: Number | UnsetType = UNSET
    overruns: Number | UnsetType = UNSET
    late_p50: Number | UnsetType = UNSET
    late_p99: Number | UnsetType = UNSET
    late_worst: Number | UnsetType = UNSET


class SetpointStatus(Struct, frozen=True):
    """The stream of set-points, and counts since the planner's start."""

    streams: Count = 0
    received: Count = 0
    refused: Count = 0
    last_refusal: str | None = None
    outliers: Count = 0
    jumps: Count = 0
    sender: str | None = None
    rate: Number = 0.0  # [1/s]
    alive: bool = False


class TrackerStatus(Struct, frozen=True):
    """The measured tips, and the bias of the tip that follows from them."""

    received: Count = 0
    accepted: Count = 0
    refused: Count = 0
    last_refusal: str | None = None
    outliers: Count = 0
    jumps: Count = 0
    estimate: list[Number] | None = None
    deviation: Number | None = None
    bias: list[Number] = []


class Diagnostics(Struct, frozen=True):
    """Health of executor, boards and planner, once a second."""

    stamp: Stamp = 0.0
    loop: LoopTimes = LoopTimes()
    buses: list[Bus] = []
    boards: list[Board] = []
    queues: dict[str, Count] = {}
    setpoint: SetpointStatus | UnsetType = UNSET
    switches: Count = 0
    counts: list[Count] = []
    waits: Count | UnsetType = UNSET
    dropped: Count = 0
    ledger: str = ""
    real_time: str = ""
    executor: str = ""
    tracker: TrackerStatus | UnsetType = UNSET


class Timeline(Struct, frozen=True):
    """Of a replay."""

    end: Stamp
    at: Stamp
    begin: Stamp = 0.0
    speed: Number = 1.0
    paused: bool = False
    file: str = ""
