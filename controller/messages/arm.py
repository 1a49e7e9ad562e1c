"""The answer to `arm`: the description of the arm, with parts on request."""

from typing import Annotated, Any, Literal

from msgspec import UNSET, Meta, Struct, UnsetType

from hyperbit.controller.messages.parts import Count, Number, Orientation, Position, Region

Frame = Annotated[list[Annotated[list[Number], Meta(min_length=4, max_length=4)]], Meta(min_length=4, max_length=4)]
Vector = Annotated[list[Number], Meta(min_length=3, max_length=3)]


class NamedPose(Struct, frozen=True):
    """A pose, with the payload of its goal without id and stamp."""

    name: str
    goal: dict[str, Any]


class Daemon(Struct, frozen=True):
    host: str | None = None
    pid: Count | None = None


class Tolerances(Struct, frozen=True):
    position: Number
    orientation: Number | None = None  # [rad]


class ModuleKind(Struct, frozen=True):
    """A kind of module: its K states of A actuators, and its structure as L segments in the frame before it."""

    bits: list[list[Annotated[int, Meta(ge=0, le=1)]]]  # (K, A)
    body: list[list[Annotated[list[Vector], Meta(min_length=2, max_length=2)]]]  # (K, L, 2, 3)


class Structure(Struct, frozen=True):
    """The drawing of an arm: its distinct modules, and the kind of each module (B,)."""

    modules: list[Annotated[int, Meta(ge=0)]]
    kinds: list[ModuleKind]


class ArmFile(Struct, frozen=True):
    name: str
    text: str
    sha256: str = ""  # of the file's bytes
    tables: dict[str, str] = {}  # CSV files that it names


class Density(Struct, frozen=True):
    """The logarithm of the whole arm's point density.

    `values` are the pixels (z, y, x), compressed by zlib, in Base64: 0 for no configuration, otherwise 1 to 255 from
    the least to the greatest.
    """

    shape: Annotated[list[Annotated[int, Meta(ge=1, le=10_000)]], Meta(min_length=3, max_length=3)]
    first: Vector  # the first pixel's centre in the base's frame
    pixel: Number  # side of a pixel
    greatest: Number  # logarithm of the greatest density
    values: str


class RunningWaypoint(Struct, frozen=True):
    t: Number
    position: Position
    orientation: Orientation | None = None


class Running(Struct, frozen=True):
    """The waypoints of the running goal, as the goal gave them."""

    goal: str | None = None
    waypoints: list[RunningWaypoint] = []


class PlayableFault(Struct, frozen=True):
    verb: str
    target: str
    argument: str
    text: str


class Simulation(Struct, frozen=True):
    """The faults that simulated boards can play, and the names that these need."""

    faults: list[PlayableFault] = []
    boards: list[str] = []
    buses: list[str] = []
    interlocks: list[str] = []


class WiredArm(Struct, frozen=True):
    """What is known of an arm without its mechanics, as of one that is commissioned."""

    name: str = ""
    unit: str | None = None
    actuators: list[str] = []
    simulated: bool = False
    daemon: Daemon = Daemon()
    poses: list[NamedPose] = []
    obstacles: list[Region] = []
    sent_obstacles: list[Region] = []


class Description(WiredArm, frozen=True):
    """The whole arm. `drawing`, `file`, `density` and `running` come only if asked for."""

    version: str | None = None
    dimension: Literal[2, 3] = 2
    length: Number = 0.0
    states: list[Count] = []  # (B,)
    frames: list[list[Frame]] = []  # of each state of each module
    base: Frame | None = None
    tip: Frame | None = None
    contracted: str = ""
    tolerance: Tolerances | None = None
    travel_time: Number = 0.0  # [s]
    on_stop: str = ""
    on_loss: str = ""
    inrush: Count | None = None
    rest_time: Number = 0.0  # [s]
    method: str = ""
    body_radius: Number = 0.0
    self_collision: bool = False
    boards: list[dict[str, Any]] = []  # each actuator's entry in the arm's file
    limits: list[str] = []
    simulation: Simulation | None = None
    drawing: Structure | UnsetType = UNSET
    file: ArmFile | UnsetType | None = UNSET
    density: Density | UnsetType = UNSET
    running: Running | UnsetType | None = UNSET
