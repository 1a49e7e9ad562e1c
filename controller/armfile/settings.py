"""The fields of an arm's YAML file, their bounds and defaults; no geometry, so that the executor can read the file."""

from pathlib import Path
from typing import Annotated, Any, Final, Literal

from msgspec import Meta, Struct, field

from hyperbit.controller.armfile.choices import BITS, LARGEST, LENGTH, SECONDS
from hyperbit.controller.armfile.documents import read_yaml
from hyperbit.controller.armfile.fields import (
    Angle,
    AngleTolerance,
    Bit,
    Count,
    Direction,
    Margin,
    Name,
    Node,
    Positive,
    Quaternion,
    Sides,
    Travel,
    Vector,
    Word,
)
from hyperbit.controller.armfile.modules import (
    MOST_MODULES,
    EntrySettings,
    FrameSettings,
    TransformsSettings,
    chain,
    count_modules,
    with_group_types,
)
from hyperbit.controller.armfile.strict import InputFaults, check
from hyperbit.controller.armfile.units import Unit, factors
from hyperbit.controller.armfile.wiring_table import read_wiring

PaperMethod = Literal["pop", "ipop-previous", "ipop-contracted"]
Variant = Literal["ipop-fewest-switches", "ipop-fewest-extended"]  # the paper's IPOP, counting actuators
MINIMUM_SWITCH: Final = "minimum-switch"
Method = Literal["minimum-switch", PaperMethod, Variant]
OnLoss = Literal["hold", "contract"]
ErrorState = Literal["off", "hold", "device"] | bool  # YAML reads a plain off as false

MOST_OBSTACLES = 256  # in one list


class RoundSettings(Struct, forbid_unknown_fields=True, frozen=True):
    """A disc or a sphere."""

    centre: Vector
    radius: Positive


class BoxSettings(Struct, forbid_unknown_fields=True, frozen=True):
    """A box, rotated about its centre: in the plane by an angle [rad], in space by a quaternion x, y, z, w."""

    centre: Vector
    size: Sides
    angle: Angle | None = None
    orientation: Quaternion | None = None


class HalfSettings(Struct, forbid_unknown_fields=True, frozen=True):
    """A half-plane or half-space, on the side of `point` that is opposite to `normal`."""

    point: Vector
    normal: Direction


class ObstacleSettings(Struct, forbid_unknown_fields=True, frozen=True):
    """An obstacle: one of these shapes, and a name for messages."""

    disc: RoundSettings | None = None
    sphere: RoundSettings | None = None
    box: BoxSettings | None = None
    half_plane: HalfSettings | None = None
    half_space: HalfSettings | None = None
    name: Name | None = None


ObstacleList = Annotated[list[ObstacleSettings], Meta(max_length=MOST_OBSTACLES)]


class ToleranceSettings(Struct, forbid_unknown_fields=True, frozen=True):
    """Default tolerances of goals."""

    position: Positive
    orientation: AngleTolerance = 0.05


class WeightSettings(Struct, forbid_unknown_fields=True, frozen=True):
    """The cost of a switch: at the base, relative to 1 at the tip; and the extra cost of the most worn actuator."""

    base: Annotated[float, Meta(gt=0, le=1000)] = 1.0
    wear: Annotated[float, Meta(ge=0, le=1000)] = 0.0


class WorkspaceSettings(Struct, forbid_unknown_fields=True, frozen=True):
    """Finest pixel (default: 1/400 of the arm's length), and memory for all densities together [MiB]."""

    pixel: Positive | None = None
    memory: Annotated[float, Meta(gt=0, le=65536)] = 512.0


class PlanningSettings(Struct, forbid_unknown_fields=True, frozen=True):
    """The time of planning that one saved switch is worth [s], and the number of processes for long plans."""

    seconds_per_switch: Annotated[float, Meta(ge=0, le=60)] = 0.01
    workers: Annotated[int, Meta(ge=0, le=64)] = 0


class BusSettings(Struct, forbid_unknown_fields=True, frozen=True):
    """One CAN bus, with python-can's names."""

    name: Name
    channel: str
    interface: Literal["socketcan", "virtual"] = "socketcan"
    bitrate: Annotated[int, Meta(ge=10_000, le=1_000_000, description=BITS)] = 1_000_000


class NodeSettings(Struct, forbid_unknown_fields=True, frozen=True):
    """One board: its identity by 1018h, its outputs, their state without the master, and whether they are read back.

    An `island` has two outputs for each valve, an even one and the next.
    """

    bus: str
    node: Node
    object: Annotated[int, Meta(ge=0x2000, le=0x6200)] = 0x6200
    vendor: Word | None = None
    product: Word | None = None
    revision: Word | None = None
    serial: Word | None = None
    error_state: ErrorState | None = None
    verify: bool = True
    island: bool = False


class BoardSettings(Struct, forbid_unknown_fields=True, frozen=True):
    """Settings of all boards; `nodes` has those of single boards. Times are seconds."""

    heartbeat: Annotated[float, Meta(ge=0.02, le=10, description=SECONDS)] = 0.1
    heartbeat_timeout: Annotated[float, Meta(ge=0.03, le=30, description=SECONDS)] = 0.35
    boot_timeout: Annotated[float, Meta(gt=0, le=120, description=SECONDS)] = 3.0
    on_loss: OnLoss = "hold"
    error_state: ErrorState | None = None
    shared_rpdo: bool = False
    settle_margin: Margin = 0.03  # after travel_time, before an actuator counts as stuck
    nodes: list[NodeSettings] = field(default_factory=list)


class TrackerSettings(Struct, forbid_unknown_fields=True, frozen=True):
    """The tip's tracker: noise, greatest corrected bias, change of the bias in a second, and time that it holds [s].

    The default of `drift` is a tenth of the noise.
    """

    noise: Positive
    clamp: Positive
    drift: Positive | None = None
    hold: Annotated[float, Meta(gt=0, le=86_400, description=SECONDS)] = 300.0


class RealTimeSettings(Struct, forbid_unknown_fields=True, frozen=True):
    """The priority of the executor's thread under SCHED_FIFO; 99 is left to the kernel's threads."""

    priority: Annotated[int, Meta(ge=1, le=98)] = 50


class BitSettings(Struct, forbid_unknown_fields=True, frozen=True):
    """One output or input of a board; an inverted one is electrically 0 for 1."""

    bit: Bit
    inverted: bool = False


class InputSettings(Struct, forbid_unknown_fields=True, frozen=True):
    """One end-stop; `board` such as "can0/9" is its board, if it is another one than that of the outputs."""

    bit: Bit
    inverted: bool = False
    board: str | None = None


class TravelSettings(Struct, forbid_unknown_fields=True, frozen=True):
    """Longest times of an actuator from end to end, one for each direction [s]."""

    extend: Travel
    contract: Travel


class InterlockSettings(Struct, forbid_unknown_fields=True, frozen=True):
    """An input, or a bit of an object, that must read 1 during motion, such as an emergency stop; 0 if `inverted`."""

    bus: str
    node: Node
    input: Bit | None = None
    object: Annotated[int, Meta(ge=0, le=0xFFFF)] | None = None
    sub: Annotated[int, Meta(ge=0, le=254)] = 0
    bit: Annotated[int, Meta(ge=0, le=31)] | None = None
    inverted: bool = False


class ActuatorSettings(Struct, forbid_unknown_fields=True, frozen=True):
    """Wiring and kind of one actuator.

    `output` extends it; without `output_off` a spring contracts it. The end-stops `input` and `input_contracted` read 1
    while the actuator is at that end. With `pulse` an output is on for this time only [s]. A `stuck` actuator never
    switches.
    """

    module: Annotated[int, Meta(ge=1)]
    actuator: str
    bus: str
    node: Node
    output: Bit | BitSettings
    output_off: Bit | BitSettings | None = None
    pulse: Annotated[float, Meta(ge=0.01, le=10, description=SECONDS)] | None = None
    input: Bit | InputSettings | None = None
    input_contracted: Bit | InputSettings | None = None
    travel_time: Travel | TravelSettings | None = None
    settle_margin: Margin | None = None
    on_loss: OnLoss | None = None
    weight: Annotated[float, Meta(gt=0, le=1000)] = 1.0
    stuck: Literal["contracted", "extended"] | None = None


class ArmSettings(Struct, forbid_unknown_fields=True, frozen=True):
    """The whole file."""

    name: Name
    modules: Annotated[list[EntrySettings], Meta(min_length=1)]
    tolerance: ToleranceSettings
    unit: Unit | None = None  # of all lengths; None: not named
    travel_time: Travel | TravelSettings = 0.05
    rest_time: Annotated[float, Meta(ge=0, le=3600, description=SECONDS)] = 0.0
    inrush: Count | None = None
    # Silence of the planner until the executor holds.
    planner_timeout: Annotated[float, Meta(ge=0.5, le=60, description=SECONDS)] = 1.0
    base: FrameSettings = FrameSettings([0.0, 0.0])
    tip: FrameSettings | None = None
    workspace: WorkspaceSettings = WorkspaceSettings()
    planning: PlanningSettings = PlanningSettings()
    method: Method = MINIMUM_SWITCH
    on_stuck: Literal["hold", "continue"] = "hold"
    on_stop: Literal["hold", "contract"] = "hold"
    weights: WeightSettings = WeightSettings()
    boards: BoardSettings = BoardSettings()
    real_time: RealTimeSettings | None = None
    tracker: TrackerSettings | None = None
    obstacles: ObstacleList = field(default_factory=list)
    body_radius: Annotated[float, Meta(ge=0, le=LARGEST, description=LENGTH)] = 0.0
    self_collision: bool = False
    buses: list[BusSettings] = field(default_factory=list)
    actuators: list[ActuatorSettings] = field(default_factory=list)
    wiring: str | None = None  # CSV file from which `actuators` was read
    interlocks: dict[Name, InterlockSettings] = field(default_factory=dict)


def files_beside(settings: ArmSettings) -> list[str]:
    """Returns the names of the CSV files that a file needs: tables of measured frames, and the wiring."""
    own = (entry.settings for entry in chain(settings.modules))
    names = [it.table for it in own if isinstance(it, TransformsSettings)]
    return list(dict.fromkeys(name for name in (*names, settings.wiring) if name is not None))


def with_wiring(document: Any, folder: Path, faults: list[str]) -> Any:
    """Returns the value of a file with `actuators` from the CSV file that `wiring` names, if it does."""
    if not isinstance(document, dict) or not isinstance(name := document.get("wiring"), str):
        return document
    if "actuators" in document:
        faults.append(f"wiring: {name}, but the file has actuators, too; the wiring stands in one place")
        return document
    return {**document, "actuators": read_wiring(folder, name, ActuatorSettings.__struct_fields__, faults)}


def parse_settings(document: Any, folder: Path, faults: list[str]) -> ArmSettings | None:
    """Returns the fields of the plain value of an arm's file, or None with the faults appended.

    `folder` is that of the file, in which its wiring is looked for.
    """
    raw = with_wiring(with_group_types(document), folder, faults)
    settings = check(raw, ArmSettings, faults, factors(raw.get("unit") if isinstance(raw, dict) else None))
    if settings is None or faults:
        return None
    if (modules := count_modules(settings.modules)) > MOST_MODULES:
        faults.append(f"modules: {modules} modules, at most {MOST_MODULES} are possible")
        return None
    return settings


def read_settings(path: Path) -> tuple[ArmSettings, list[str]]:
    """Returns the fields of an arm's file, and the faults that involve several fields.

    Raises:
        InputFaults: the file is missing or unreadable, or a field is wrong.
    """
    faults: list[str] = []
    settings = parse_settings(read_yaml(path), path.parent, faults)
    if settings is None:
        raise InputFaults(path, faults)
    boards = settings.boards
    if boards.heartbeat_timeout <= 1.5 * boards.heartbeat:
        faults.append(
            f"boards.heartbeat_timeout: {boards.heartbeat_timeout:g} s is too short for heartbeats every"
            f" {boards.heartbeat:g} s; more than 1.5 times that is needed"
        )
    return settings, faults
