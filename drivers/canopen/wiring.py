"""The wiring of an arm: buses, boards, and the output and end-stop of each actuator."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from functools import cached_property
from typing import Literal, NamedTuple

MASTER = 127  # node id of this master's heartbeat
GREATEST_BIT = 2031  # of 6000h and 6200h: 254 sub-indices of 8 bits

LINES = ("output", "output_off", "input", "input_contracted")  # fields of `Channel`

OnLoss = Literal["hold", "contract"]
ErrorState = Literal["off", "hold", "device"]


@dataclass(frozen=True)
class BusWiring:
    """One CAN bus.

    Attributes:
        name: name in the arm's file and in messages, e.g. "can0".
        interface: interface of python-can, e.g. "socketcan" or "virtual".
        channel: channel of that interface, e.g. "can0".
        bitrate: [bit/s]. On SocketCAN only the load figure uses it; the system configures the interface.
    """

    name: str
    interface: str
    channel: str
    bitrate: int = 1_000_000


class BoardId(NamedTuple):
    """A board: the name of its bus, and its node id."""

    bus: str
    node: int

    def __str__(self) -> str:
        return f"{self.bus}/{self.node}"


class BoardLine(NamedTuple):
    """One output or input of a board.

    Attributes:
        bus: name of its bus.
        node: node id of its board.
        bit: bit of 6200h or 6000h.
        inverted: whether it is electrically 0 while its level is 1.
    """

    bus: str
    node: int
    bit: int
    inverted: bool = False

    @property
    def board(self) -> BoardId:
        """Its board."""
        return BoardId(self.bus, self.node)


@dataclass(frozen=True)
class Channel:
    """The wiring of one actuator. Its position in `Wiring.channels` is the actuator's index and its bit in masks.

    An actuator with `output_off` has two outputs. At most one of them is on; while both are off, the actuator stays
    where it is. All its outputs are on one board. Its inputs may be on other boards, also of other buses.

    Attributes:
        actuator: label for messages, e.g. "5.left".
        bus: name of a bus.
        node: node id of the board of its outputs, 1..126 (127 is the master).
        output: bit of 6200h that extends it, 0..2031 (sub-index 1 + bit // 8).
        input: bit of 6000h that reads 1 while the actuator is extended; None without that end-stop.
        output_off: bit of 6200h that contracts it; None: a spring contracts it while `output` is off.
        input_contracted: bit of 6000h that reads 1 while the actuator is contracted; None without that end-stop.
        inverted: names of the fields among these four whose bit is electrically 0 while its level is 1.
        pulse: an output is on for this time after a switch [s]; None: it stays on.
        travel: longest times to the contracted and to the extended end [s]; None: `Timing.travel_time`.
        settle_margin: margin after the travel time [s]; None: `Timing.settle_margin`.
        on_loss: as in `Wiring`, for this actuator alone; None: as in `Wiring`.
        input_board: board of `input`; None: the board of the outputs.
        input_contracted_board: board of `input_contracted`, likewise.

    Raises:
        ValueError: a number is out of its range, or the fields contradict each other.
    """

    actuator: str
    bus: str
    node: int
    output: int
    input: int | None
    output_off: int | None = None
    input_contracted: int | None = None
    inverted: frozenset[str] = frozenset()
    pulse: float | None = None
    travel: tuple[float, float] | None = None
    settle_margin: float | None = None
    on_loss: OnLoss | None = None
    input_board: BoardId | None = None
    input_contracted_board: BoardId | None = None

    def __post_init__(self) -> None:
        for node in (self.node, *(board.node for board in (self.input_board, self.input_contracted_board) if board)):
            if not 1 <= node < MASTER:
                raise ValueError(f"actuator {self.actuator}: node {node} is not in 1..126 (127 is the master)")
        for name in LINES:
            bit = getattr(self, name)
            if bit is not None and not 0 <= bit <= GREATEST_BIT:
                raise ValueError(f"actuator {self.actuator}: {name} {bit} is not in 0..{GREATEST_BIT}")
        if self.pulse is not None and self.output_off is None:
            raise ValueError(f"actuator {self.actuator}: a pulse of {self.pulse:g} s needs output_off as well")

    @property
    def place(self) -> str:
        """The actuator and its output, for messages."""
        return f"{self.actuator} ({self.bus}/{self.node} output {self.output})"

    def line(self, name: str) -> BoardLine | None:
        """Returns the line of "output", "input", "output_off" or "input_contracted"; None if it has none."""
        bit: int | None = getattr(self, name)
        if bit is None:
            return None
        other = {"input": self.input_board, "input_contracted": self.input_contracted_board}.get(name)
        return BoardLine(*(other or (self.bus, self.node)), bit, name in self.inverted)

    @property
    def lines(self) -> dict[str, BoardLine]:
        """Its outputs and inputs, by the names of their fields."""
        return {name: line for name in LINES if (line := self.line(name)) is not None}


@dataclass(frozen=True)
class Interlock:
    """An input that must be closed, level 1, while anything moves: emergency stop, air pressure, guard door.

    Attributes:
        name: name for messages.
        bus: name of a bus.
        node: node id of its board.
        input: bit of 6000h.
        inverted: whether the bit is 0 while the interlock is closed.
    """

    name: str
    bus: str
    node: int
    input: int
    inverted: bool = False

    @property
    def line(self) -> BoardLine:
        """The input line."""
        return BoardLine(self.bus, self.node, self.input, self.inverted)


@dataclass(frozen=True)
class NodeWiring:
    """The entry of one board in `boards.nodes` of the arm's file.

    Attributes:
        bus: name of a bus.
        node: node id.
        object: index of its outputs, an array of bytes from sub-index 1: 6200h, or 2000h..5FFFh of a maker.
        vendor: needed value of 1018h sub 1; None: any.
        product: 1018h sub 2, likewise.
        revision: 1018h sub 3, likewise.
        serial: 1018h sub 4, likewise.
        error_state: as in `Wiring`, for this board alone; None: as in `Wiring`.
        verify: whether a switch without end-stops counts only when its outputs were read back.

    Raises:
        ValueError: a number is out of its range.
    """

    bus: str
    node: int
    object: int = 0x6200
    vendor: int | None = None
    product: int | None = None
    revision: int | None = None
    serial: int | None = None
    error_state: ErrorState | None = None
    verify: bool = True

    def __post_init__(self) -> None:
        if self.object != 0x6200 and not 0x2000 <= self.object <= 0x5FFF:
            raise ValueError(f"board {self.bus}/{self.node}: object {self.object:04X}h is not 6200h or 2000h..5FFFh")


@dataclass(frozen=True)
class Wiring:
    """The wiring of one arm.

    Attributes:
        buses: the CAN buses.
        channels: one for each actuator.
        on_loss: what the outputs do when the boards lose the master.
        shared_rpdo: boards of a bus share frames of up to 8 output bytes (dummy mapping, CiA 301, 7.4.7).
        error_state: what the outputs of boards without 6206h and 6207h do when the boards lose the master, as the user
            knows it: they go "off", "hold", or do what the "device" is set to; None: such boards are refused.
        nodes: further settings of single boards.
        interlocks: inputs that must be closed while anything moves.

    Raises:
        ValueError: a name, output, input or node occurs twice, a channel, node or interlock names an unknown bus, or
            an actuator with pulses has on_loss "contract".
    """

    buses: tuple[BusWiring, ...]
    channels: tuple[Channel, ...]
    on_loss: OnLoss = "hold"
    shared_rpdo: bool = False
    error_state: ErrorState | None = None
    nodes: tuple[NodeWiring, ...] = ()
    interlocks: tuple[Interlock, ...] = ()

    def __post_init__(self) -> None:
        names = [bus.name for bus in self.buses]
        _refuse_duplicates("bus", names)
        for channel in self.channels:
            for line in channel.lines.values():
                if line.bus not in names:
                    raise ValueError(f"actuator {channel.actuator}: bus {line.bus} is not one of {', '.join(names)}")
            if channel.pulse is not None and (channel.on_loss or self.on_loss) == "contract":
                raise ValueError(f"actuator {channel.actuator}: it has pulses, so it cannot contract on loss")
        for lock in self.interlocks:
            if lock.bus not in names:
                raise ValueError(f"interlock {lock.name}: bus {lock.bus} is not one of {', '.join(names)}")
        _refuse_duplicates("actuator", [c.actuator for c in self.channels])
        _refuse_duplicates("interlock", [lock.name for lock in self.interlocks])
        _refuse_duplicates("output", [f"{c.bus}/{c.node} output {c.bit}" for c in self.output_lines])
        _refuse_duplicates("input", [f"{c.bus}/{c.node} input {c.bit}" for c in self.input_lines if c is not None])
        for node in self.nodes:
            if node.bus not in names:
                raise ValueError(f"board {node.bus}/{node.node}: bus {node.bus} is not one of {', '.join(names)}")
        _refuse_duplicates("node", [f"{node.bus}/{node.node}" for node in self.nodes])
        if self.on_loss not in ("hold", "contract"):
            raise ValueError(f"on_loss is {self.on_loss!r}, not 'hold' or 'contract'")

    @cached_property
    def boards(self) -> tuple[BoardId, ...]:
        """All boards with an output or input, by bus in the order of `buses`, then by node id."""
        order = {bus.name: i for i, bus in enumerate(self.buses)}
        found = {line.board for line in (*self.output_lines, *self.input_lines) if line is not None}
        return tuple(sorted(found, key=lambda board: (order[board.bus], board.node)))

    @cached_property
    def paired(self) -> tuple[int, ...]:
        """Indices of the actuators with two outputs; output line A + i is the `output_off` of the i-th of them."""
        return tuple(k for k, channel in enumerate(self.channels) if channel.output_off is not None)

    @cached_property
    def ended(self) -> tuple[int, ...]:
        """Indices of the actuators with an `input_contracted`; input line A + i is that of the i-th of them."""
        return tuple(k for k, channel in enumerate(self.channels) if channel.input_contracted is not None)

    @cached_property
    def output_lines(self) -> tuple[BoardLine, ...]:
        """All outputs: the `output` of each of the A actuators, then each `output_off` in the order of `paired`."""
        return tuple(line for line in (*self._of_all("output"), *self._of_all("output_off")) if line is not None)

    @cached_property
    def input_lines(self) -> tuple[BoardLine | None, ...]:
        """All inputs: the `input` of each actuator, None without one; each `input_contracted`; the interlocks."""
        contracted = [line for line in self._of_all("input_contracted") if line is not None]
        return (*self._of_all("input"), *contracted, *(lock.line for lock in self.interlocks))

    @property
    def interlock_lines(self) -> range:
        """Indices of the input lines of the interlocks: the last ones."""
        return range(len(self.input_lines) - len(self.interlocks), len(self.input_lines))

    @cached_property
    def loss_levels(self) -> tuple[int | None, ...]:
        """The level that each output line takes when its board loses the master; None: it keeps its level.

        Lines of actuators with pulses go off: otherwise a running pulse would not end.
        """
        pairs = [self.channels[k] for k in self.paired]
        return tuple(self._loss_level(c, 0) for c in self.channels) + tuple(self._loss_level(c, 1) for c in pairs)

    def _loss_level(self, channel: Channel, contracting: int) -> int | None:
        if channel.pulse is not None:
            return 0
        return contracting if (channel.on_loss or self.on_loss) == "contract" else None

    def _of_all(self, name: str) -> list[BoardLine | None]:
        return [channel.line(name) for channel in self.channels]


@dataclass(frozen=True)
class Timing:
    """Times of boards and actuators, all in [s].

    Attributes:
        heartbeat: period of the heartbeats of the boards (1017h) and of the master.
        heartbeat_timeout: a board silent for this long is lost; the boards get the same for the master (1016h).
        boot_timeout: longest time that boards need to boot, and to become operational.
        travel_time: longest time of an actuator from end to end.
        settle_margin: added to the travel time before the measured state is compared with the commanded one.

    Raises:
        ValueError: a time is out of its range.
    """

    heartbeat: float = 0.1
    heartbeat_timeout: float = 0.35
    boot_timeout: float = 3.0
    travel_time: float = 0.05
    settle_margin: float = 0.03

    def __post_init__(self) -> None:
        if not 0.001 <= self.heartbeat < self.heartbeat_timeout <= 65.535:
            raise ValueError(
                f"heartbeat {self.heartbeat} s and heartbeat_timeout {self.heartbeat_timeout} s:"
                " the first must be at least 0.001 and less than the second, the second at most 65.535"
            )
        for name in ("boot_timeout", "travel_time", "settle_margin"):
            if not getattr(self, name) >= 0.0:
                raise ValueError(f"{name} is {getattr(self, name)} s, not 0 or more")


def _refuse_duplicates(what: str, names: list[str]) -> None:
    duplicates = [name for name, times in Counter(names).items() if times > 1]
    if duplicates:
        raise ValueError(f"{what} {duplicates[0]} is there twice")
