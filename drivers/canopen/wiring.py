"""The wiring of an arm: buses, boards, and the output and end-stop of each actuator."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import Literal

MASTER = 127  # node id of this master's heartbeat
GREATEST_BIT = 2031  # of 6000h and 6200h: 254 sub-indices of 8 bits

ErrorState = Literal["off", "hold", "device"]


@dataclass(frozen=True)
class BusSettings:
    """One CAN bus.

    Attributes:
        name: as in the arm's file and in messages, e.g. "can0".
        interface: of python-can, e.g. "socketcan" or "virtual".
        channel: of that interface, e.g. "can0".
        bitrate: [bit/s]. On SocketCAN only the load figure uses it; the system configures the interface.
    """

    name: str
    interface: str
    channel: str
    bitrate: int = 1_000_000


@dataclass(frozen=True)
class Channel:
    """The wiring of one actuator. Its place in `Wiring.channels` is the actuator's index and its bit in masks.

    Attributes:
        actuator: label for messages, e.g. "5.left".
        bus: name of a bus.
        node: node id of the board, 1..126 (127 is the master).
        output: bit of 6200h, 0..2031 (sub-index 1 + bit // 8).
        input: bit of 6000h that reads 1 if the actuator is extended; None without an end-stop.

    Raises:
        ValueError: a number is out of its range.
    """

    actuator: str
    bus: str
    node: int
    output: int
    input: int | None

    def __post_init__(self) -> None:
        if not 1 <= self.node < MASTER:
            raise ValueError(f"actuator {self.actuator}: node {self.node} is not in 1..126 (127 is the master)")
        if not 0 <= self.output <= GREATEST_BIT:
            raise ValueError(f"actuator {self.actuator}: output {self.output} is not in 0..{GREATEST_BIT}")
        if self.input is not None and not 0 <= self.input <= GREATEST_BIT:
            raise ValueError(f"actuator {self.actuator}: input {self.input} is not in 0..{GREATEST_BIT}")

    @property
    def place(self) -> str:
        """The actuator and its output, for messages."""
        return f"{self.actuator} ({self.bus}/{self.node} output {self.output})"


@dataclass(frozen=True)
class NodeSettings:
    """What an arm's file says of one board beyond the places of its actuators.

    Attributes:
        bus: name of a bus.
        node: node id.
        object: index of its outputs, an array of bytes from sub-index 1: 6200h, or 2000h..5FFFh of a maker.
        vendor: 1018h sub 1 that the board must hold; None: any.
        product: 1018h sub 2, likewise.
        revision: 1018h sub 3, likewise.
        serial: 1018h sub 4, likewise.
        error_state: as in `Wiring`, of this board alone; None: as of all boards.

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

    def __post_init__(self) -> None:
        if self.object != 0x6200 and not 0x2000 <= self.object <= 0x5FFF:
            raise ValueError(f"board {self.bus}/{self.node}: object {self.object:04X}h is not 6200h or 2000h..5FFFh")


@dataclass(frozen=True)
class Wiring:
    """The wiring of one arm.

    Attributes:
        buses: the CAN buses.
        channels: one for each actuator.
        on_loss: what the boards do with their outputs when they no longer hear the master.
        shared_rpdo: boards of a bus share frames of up to 8 output bytes (dummy mapping, CiA 301, 7.4.7).
        error_state: what the outputs of boards without 6206h and 6207h do if the master is no longer heard: go "off" or
            "hold", as a person knows it, or whatever the "device" does; None: such boards are refused.
        nodes: boards of which more is to be said.

    Raises:
        ValueError: a name, output, input or node is there twice, or a channel or node names an unknown bus.
    """

    buses: tuple[BusSettings, ...]
    channels: tuple[Channel, ...]
    on_loss: Literal["hold", "contract"] = "hold"
    shared_rpdo: bool = False
    error_state: ErrorState | None = None
    nodes: tuple[NodeSettings, ...] = ()

    def __post_init__(self) -> None:
        names = [bus.name for bus in self.buses]
        _refuse_duplicates("bus", names)
        for channel in self.channels:
            if channel.bus not in names:
                raise ValueError(f"actuator {channel.actuator}: bus {channel.bus} is not one of {', '.join(names)}")
        _refuse_duplicates("actuator", [c.actuator for c in self.channels])
        _refuse_duplicates("output", [f"{c.bus}/{c.node} output {c.output}" for c in self.channels])
        inputs = [f"{c.bus}/{c.node} input {c.input}" for c in self.channels if c.input is not None]
        _refuse_duplicates("input", inputs)
        for node in self.nodes:
            if node.bus not in names:
                raise ValueError(f"board {node.bus}/{node.node}: bus {node.bus} is not one of {', '.join(names)}")
        _refuse_duplicates("node", [f"{node.bus}/{node.node}" for node in self.nodes])
        if self.on_loss not in ("hold", "contract"):
            raise ValueError(f"on_loss is {self.on_loss!r}, not 'hold' or 'contract'")


@dataclass(frozen=True)
class Timing:
    """Times of boards and actuators, all in [s].

    Attributes:
        heartbeat: period of the heartbeats of the boards (1017h) and of the master.
        heartbeat_timeout: a board silent for this long is lost; the boards get the same for the master (1016h).
        boot_timeout: longest time that boards need to boot, and to become operational.
        travel_time: longest time of an actuator from end-stop to end-stop.
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
