"""The wiring of an arm: buses, boards, and the output and end-stop of each actuator."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Literal, NamedTuple

MASTER = 127  # node id of this master's heartbeat

LINES = ("output", "output_off", "input", "input_contracted")  # fields of `Channel`

OnLoss = Literal["hold", "contract"]
ErrorState = Literal["off", "hold", "device"]


@dataclass(frozen=True)
class BusWiring:
    """One CAN bus."""

    name: str  # in the arm's file and in messages, e.g. "can0"
    interface: str  # of python-can, e.g. "socketcan" or "virtual"
    channel: str  # of that interface, e.g. "can0"
    bitrate: int = 1_000_000  # [bit/s]; on SocketCAN only the load figure uses it: the system configures the interface


class BoardId(NamedTuple):
    """A board: the name of its bus, and its node id."""

    bus: str
    node: int

    def __str__(self) -> str:
        return f"{self.bus}/{self.node}"


class WatchedObject(NamedTuple):
    """An object of a board other than its outputs and inputs."""

    object: int  # index
    sub: int

    def __str__(self) -> str:
        return f"{self.object:04X}h sub {self.sub}"


class BoardLine(NamedTuple):
    bus: str
    node: int
    bit: int  # of 6200h or 6000h, or of `watched`
    inverted: bool = False  # electrically 0 while its level is 1
    watched: WatchedObject | None = None  # has the bit of an interlock; None: 6000h has it

    @property
    def board(self) -> BoardId:
        return BoardId(self.bus, self.node)


@dataclass(frozen=True)
class Channel:
    """The wiring of one actuator. Its position in `Wiring.channels` is the actuator's index and its bit in masks.

    An actuator with `output_off` has two outputs. At most one of them is on; while both are off, the actuator stays
    where it is. All its outputs are on one board. Its inputs may be on other boards, also of other buses.
    """

    actuator: str  # label for messages, e.g. "5.left"
    bus: str
    node: int  # of the board of its outputs, 1..126 (127 is the master)
    output: int  # bit of 6200h that extends it, 0..2031 (sub-index 1 + bit // 8)
    input: int | None  # bit of 6000h that reads 1 while the actuator is extended; None: no such end-stop
    output_off: int | None = None  # bit of 6200h that contracts it; None: a spring contracts it while `output` is off
    # bit of 6000h that reads 1 while the actuator is contracted; None: no such end-stop
    input_contracted: int | None = None
    # names of these four fields whose bit is electrically 0 while its level is 1
    inverted: frozenset[str] = frozenset()
    pulse: float | None = None  # an output is on for this time after a switch [s]; None: it stays on
    # longest times to the contracted and to the extended end [s]; None: `Timing.travel_time`
    travel: tuple[float, float] | None = None
    settle_margin: float | None = None  # after the travel time [s]; None: `Timing.settle_margin`
    on_loss: OnLoss | None = None  # None: as in `Wiring`
    input_board: BoardId | None = None  # of `input`; None: the board of the outputs
    input_contracted_board: BoardId | None = None  # likewise

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
    """A bit that must be closed, level 1, while anything moves: emergency stop, air pressure, supply of the valves."""

    name: str  # for messages
    bus: str
    node: int
    bit: int  # of 6000h, or of `watched`
    inverted: bool = False  # the bit is 0 while the interlock is closed
    watched: WatchedObject | None = None  # None: 6000h

    @property
    def line(self) -> BoardLine:
        return BoardLine(self.bus, self.node, self.bit, self.inverted, self.watched)

    @property
    def place(self) -> str:
        """Its bit for messages, e.g. "can0/9 input 3" or "can0/5 2102h sub 0 bit 0"."""
        return f"{self.bus}/{self.node} " + (f"{self.watched} bit" if self.watched else "input") + f" {self.bit}"


@dataclass(frozen=True)
class NodeWiring:
    """The entry of one board in `boards.nodes` of the arm's file."""

    bus: str
    node: int
    object: int = 0x6200  # index of its outputs, an array of bytes from sub-index 1: 6200h, or 2000h..5FFFh of a maker
    vendor: int | None = None  # needed value of 1018h sub 1; None: any
    product: int | None = None  # 1018h sub 2, likewise
    revision: int | None = None  # 1018h sub 3, likewise
    serial: int | None = None  # 1018h sub 4, likewise
    error_state: ErrorState | None = None  # None: as in `Wiring`
    verify: bool = True  # a switch without end-stops counts only after its outputs were read back


@dataclass(frozen=True)
class Wiring:
    """The wiring of one arm.

    `error_state` says what outputs of boards without 6206h and 6207h do when the boards lose the master: they go "off",
    "hold", or do what the "device" is set to. With None such boards are refused.

    Who makes it has checked it, as the arm's file is checked: each number is in its range, each name is known, and
    nothing is there twice.
    """

    buses: tuple[BusWiring, ...]
    channels: tuple[Channel, ...]  # one for each actuator
    on_loss: OnLoss = "hold"  # what outputs do when the boards lose the master
    shared_rpdo: bool = False  # boards of a bus share frames of up to 8 output bytes (dummy mapping, CiA 301, 7.4.7)
    error_state: ErrorState | None = None
    nodes: tuple[NodeWiring, ...] = ()  # further settings of single boards
    interlocks: tuple[Interlock, ...] = ()  # bits that must be closed while anything moves

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
        """Indices of the actuators with an `input_contracted`; input line A + i belongs to the i-th of them."""
        return tuple(k for k, channel in enumerate(self.channels) if channel.input_contracted is not None)

    @cached_property
    def outputs_of(self) -> tuple[int, ...]:
        """The output lines of each actuator as a mask: its `output`, and its `output_off` if it has one."""
        second = {k: 1 << len(self.channels) + i for i, k in enumerate(self.paired)}
        return tuple(1 << k | second.get(k, 0) for k in range(len(self.channels)))

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
    def contracting(self) -> tuple[int, ...]:
        """Indices of the actuators that their boards contract when they lose the master."""
        told = [(k, it.on_loss or self.on_loss) for k, it in enumerate(self.channels) if it.pulse is None]
        return tuple(k for k, on_loss in told if on_loss == "contract")

    @cached_property
    def loss_levels(self) -> tuple[int | None, ...]:
        """The level that each output line takes when its board loses the master; None: it keeps its level.

        Lines of actuators with pulses go off: otherwise a running pulse would not end.
        """
        first: list[int | None] = [None if it.pulse is None else 0 for it in self.channels]
        second = [first[k] for k in self.paired]
        for k in self.contracting:
            first[k] = 0
            if k in self.paired:
                second[self.paired.index(k)] = 1
        return (*first, *second)

    def _of_all(self, name: str) -> list[BoardLine | None]:
        return [channel.line(name) for channel in self.channels]


@dataclass(frozen=True)
class Timing:
    """Times of boards and actuators, all in [s]; checked as the wiring is."""

    heartbeat: float = 0.1  # period of the boards (1017h) and of the master
    # a board silent for this long is lost; the boards get the same for the master (1016h)
    heartbeat_timeout: float = 0.35
    boot_timeout: float = 3.0  # longest time that boards need to boot, and to become operational
    travel_time: float = 0.05  # longest time of an actuator from end to end
    settle_margin: float = 0.03  # added to the travel time before the measured state is compared with the commanded one


LATE = 0.011  # [s], a period of the master's ticks and what timers add


def next_due(due: float, period: float, now: float) -> float:
    """Returns when something periodic that was `due` is due again [s].

    It keeps its phase, so that ticks which are a little late do not add up.
    """
    return (due if now <= due + LATE else now) + period
