"""The CANopen master alone, on buses and boards of the simulation and on their clock.

A test boots a world by `up`, calls the master's methods, causes faults, and reads frames, faults and pins.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

from hyperbit.drivers.canopen.faults import ArmFault, Busy
from hyperbit.drivers.canopen.run.heartbeat import BEAT
from hyperbit.drivers.canopen.run.master import Master
from hyperbit.drivers.canopen.wire import cia301
from hyperbit.drivers.canopen.wire.cia301 import Command, Frame
from hyperbit.drivers.canopen.wire.events import BusChanged, Event, FrameEchoed, SendFailed
from hyperbit.drivers.canopen.wiring import BusWiring, Channel, Timing, Wiring
from hyperbit.drivers.simulation.firmware import SimulatedBoard
from hyperbit.drivers.simulation.objects import Objects
from hyperbit.drivers.simulation.variants import STANDARD, VARIANTS, Variant
from tests.simulation.buses.boards import Hardware
from tests.simulation.buses.bus_model import OnItsWay

TICK = 0.01
BOARD = "can0/5"  # which the words below mean if they name no other
LONGEST_BOOT = 60.0  # [s] of a board whose SDO answers take 0.6 s


class World(Hardware):
    """A master and the boards of its wiring; the boards have power, and answer SDO after `latency` [s] or later.

    Attributes:
        stalled: whether the master's loop stands still; events wait for it.
        deaf: whether the boards do not hear a frame of the master.
        beats: times at which heartbeats of the master have left [s].
    """

    def __init__(
        self,
        channels: list[Channel] | None = None,
        timing: Timing | None = None,
        *,
        variant: str | Variant = STANDARD,
        variants: Mapping[str, Variant] | None = None,
        latency: float = 0.001,
        bitrate: int = 1_000_000,
        **options: object,
    ) -> None:
        channels = channels or one_board()
        names = sorted({line.bus for c in channels for line in c.lines.values()})
        buses = tuple(BusWiring(name, "none", name, bitrate) for name in names)
        self.wiring = Wiring(buses, tuple(channels), **options)
        self.timing = timing or Timing()
        given = {str(board): STANDARD for board in self.wiring.boards}
        if BOARD in given:
            given[BOARD] = VARIANTS[variant] if isinstance(variant, str) else variant
        given |= dict(variants or {})
        late = {board: answering(variant, latency) for board, variant in given.items()}
        super().__init__(self.wiring, self.timing, self._to_master, late)
        for bus in self.buses.values():
            bus.log = []
        self.run, self.until, self.after = self.agenda.run, self.agenda.until, self.agenda.after
        self.stalled = False
        self.deaf: Callable[[Frame], bool] = lambda frame: False
        self.beats: list[float] = []
        self.switched: list[tuple[int, float]] = []
        self._faults: list[ArmFault] = []
        self._waiting: list[Event] = []
        self.master: Any = None
        self.new_master()
        self.after(0.0, self._tick)

    # The master's process.

    def new_master(self, **options: object) -> None:
        """Replaces the master, which is killed; `options` change its wiring."""
        self.wiring = replace(self.wiring, **options)
        self.use(Master(self.wiring, self.timing, self.send))
        for name, bus in self.buses.items():
            self.master.receive_event(BusChanged(name, bus.state, "", None), self.now)

    def use(self, master: Any) -> None:
        """Replaces the master by another or a tool; it hears nothing that came before."""
        self._collect()
        self.master = master
        self._waiting.clear()

    def lose_master(self, **options: object) -> None:
        """The boards lose the master; then a new one starts."""
        self.stalled = True
        self.run(2.0)
        self.stalled = False
        self.new_master(**options)

    def send(self, bus: str, frame: Frame) -> None:
        """Sends a frame of the master; it hears of a failure afterwards."""
        why = self.buses[bus].send_frame(frame)
        if why is not None:
            self.after(0.0, lambda: self._to_master(SendFailed(bus, frame, why)))

    def stall(self, seconds: float) -> None:
        """Stalls the master's loop; then it ticks, and takes the events of this time in order."""
        self.stalled = True
        self.run(seconds)
        self.stalled = False
        self.tick()

    def tick(self) -> None:
        self.master.tick(self.now)
        waiting, self._waiting = self._waiting, []
        for event in waiting:
            self._to_master(event)
        self._collect()

    def _tick(self) -> None:
        if not self.stalled:
            self.tick()
        self.after(TICK, self._tick)

    def _to_master(self, event: Event) -> None:
        if isinstance(event, FrameEchoed) and event.frame == BEAT:
            self.beats.append(self.now)
        if self.stalled:
            self._waiting.append(event)
        elif isinstance(event, SendFailed) and not isinstance(self.master, Master):
            self.master.send_failed(event.bus, event.frame, self.now)
        else:
            self.master.receive_event(event, self.now)
            self._collect()

    # What it is asked for.

    def boot(self) -> list[ArmFault]:
        self.run(0.05)  # the boards have long booted when the master comes
        self.master.boot(self.now)
        self.until(lambda: not self.master.booting.under_way, LONGEST_BOOT)
        return list(self.master.booting.faults)

    def up(self) -> World:
        assert self.boot() == []
        assert self.master.outputs_known
        self.frames()
        return self

    def commit(self, *states: int, then: float = 0.0) -> None:
        """Commits, and runs until the commit has ended, and `then` [s] longer."""
        self.master.commit(bits(*states), self.now)
        self.until(lambda: not self.master.switching.under_way)
        if then:
            self.run(then)

    def commit_when_possible(self, *states: int) -> None:
        def taken() -> bool:
            try:
                self.commit(*states)
            except Busy:
                return False
            return self.master.switching.failed is None

        while not taken():
            self.run(TICK)

    def release(self, outputs: int = 0, ticks: int = 25) -> None:
        """Releases at each tick, as the executor does; by default until two heartbeats have left."""
        for _ in range(ticks):
            self.master.release(~outputs, self.now)
            self.run(TICK)

    # What happens to it.

    def board(self, name: str = BOARD) -> SimulatedBoard:
        return self.boards.board(name)

    @property
    def objects(self) -> Objects:
        return self.board().objects

    def lose(self, *cob_ids: int) -> None:
        """Loses all frames of boards with these COB-IDs, and no others any more."""
        self.lost = lambda bus, frame: frame.id in cob_ids

    def say(self, cob_id: int, data: bytes = b"", bus: str = "can0") -> None:
        """Sends a frame of another program."""
        self.buses[bus].from_other(Frame(cob_id, data))

    def nmt(self, command: Command, node: int = 5) -> None:
        self.say(cia301.NMT, bytes([command, node]))

    def cycle_power(self, board: str = BOARD) -> None:
        self.fault("power_cut", board)
        self.fault("power_on", board)

    def _to_boards(self, bus: str, sent: OnItsWay, lost: bool) -> None:
        super()._to_boards(bus, sent, lost or self.deaf(sent.frame))

    # What is told and seen.

    def frames(self, bus: str = "can0", sdo: bool = False) -> list[tuple[int, str]]:
        """Returns COB-ID and data of the frames since the last call, without heartbeats, and without SDO by default."""
        log, self.buses[bus].log = self.buses[bus].log or [], []
        left_out = (cia301.HEARTBEAT,) if sdo else (cia301.HEARTBEAT, cia301.SDO_REQUEST, cia301.SDO_ANSWER)
        return [(frame.id, frame.data.hex(" ")) for frame in log if frame.id & 0x780 not in left_out]

    def requests(self, node: int = 5) -> list[str]:
        """Returns the SDO requests to a board since the last call."""
        return [data for cob_id, data in self.frames(sdo=True) if cob_id == cia301.SDO_REQUEST + node]

    @property
    def faults(self) -> list[ArmFault]:
        self._collect()
        return self._faults

    def told(self) -> list[str]:
        """Returns the codes of all faults so far, without those of boots."""
        return [fault.code for fault in self.faults]

    def next_told(self) -> list[str]:
        """Waits for a fault."""
        self.until(self.told)
        return self.told()

    def warned(self) -> list[str]:
        return [warning.code for warning in self.master.warnings()]

    def pins(self, board: str = BOARD) -> int:
        return self.board(board).pins

    def outputs(self, board: str = BOARD) -> int:
        """Returns the first byte of 6200h, the last command, which the pins need not show."""
        return self.board(board).objects.number(0x6200, 1)

    def positions(self) -> list[float]:
        self._attached.step()
        return self.boards.positions()

    def switches(self) -> list[int]:
        return self.boards.switches()

    def coils(self) -> list[tuple[int, int]]:
        return self.boards.coils()

    def measured(self) -> list[int]:
        """States, -1 where unknown."""
        states, known = measured(self.master, self.wiring), self.master.inputs.known
        return [states >> k & 1 if known >> k & 1 else -1 for k in range(len(self.wiring.channels))]

    def _collect(self) -> None:
        if isinstance(self.master, Master):
            self._faults += self.master.faults.drain()
            self.switched += self.master.switching.drain()


@functools.cache
def answering(variant: Variant, latency: float) -> Variant:
    return replace(variant, answer_delay=variant.answer_delay + latency)


def measured(master: Master, wiring: Wiring) -> int:
    """Returns the states of actuators with one output: the end-stop, else the output; 0 where unknown."""
    ended = sum(1 << k for k, channel in enumerate(wiring.channels) if channel.input is not None)
    everything = (1 << len(wiring.channels)) - 1
    return (master.inputs.ends & ended | master.outputs.commanded & ~ended) & everything & master.inputs.known


def spoken(world: World) -> str:
    """Returns the frames since the last call in lines: what the master sends, and the answer of the board to it."""
    lines: list[str] = []
    for cob_id, data in world.frames(sdo=True):
        frame = f"{cob_id:03x} {data}".strip()
        if cob_id & 0x780 == cia301.SDO_ANSWER and lines:
            lines[-1] = f"{lines[-1]:40}| {frame}"
        else:
            lines.append(frame)
    return "".join(f"{line}\n" for line in lines)


def bits(*states: int) -> int:
    return sum(state << k for k, state in enumerate(states))


def one_board() -> list[Channel]:
    return [Channel("5.left", "can0", 5, 0, 0), Channel("5.right", "can0", 5, 1, 1)]


def two_boards() -> list[Channel]:
    return [Channel("5.left", "can0", 5, 0, 0), Channel("9.left", "can0", 9, 3, 2)]


def two_buses() -> list[Channel]:
    return [Channel("a", "can0", 5, 0, 0), Channel("b", "can1", 5, 0, 0)]


def each_node(count: int, *, end_stop: bool = True, buses: int = 1) -> list[Channel]:
    """Returns an actuator on each of `count` boards, numbered from 1 on each bus."""
    places = [(f"can{bus}", node) for bus in range(buses) for node in range(1, 1 + count // buses)]
    return [Channel(f"{bus}/{node}", bus, node, 0, 0 if end_stop else None) for bus, node in places]
