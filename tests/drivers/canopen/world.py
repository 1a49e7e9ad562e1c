"""The CANopen master alone on the simulation's buses and boards: a test calls its methods, and reads what it says."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from hyperbit.drivers.canopen.faults import ArmFault, Busy
from hyperbit.drivers.canopen.run.master import Master
from hyperbit.drivers.canopen.wire import cia301
from hyperbit.drivers.canopen.wire.cia301 import Frame
from hyperbit.drivers.canopen.wire.events import BusChanged, Event, SendFailed
from hyperbit.drivers.canopen.wiring import BusWiring, Channel, Timing, Wiring
from hyperbit.drivers.simulation.variants import STANDARD, Variant
from tests.simulation.buses.hardware import Hardware

TICK = 0.01


class World(Hardware):
    """A master and the boards of its wiring; the boards have power, and answer SDO after `latency` [s] or later.

    Attributes:
        stalled: whether the master's loop stands still; events wait for it.
    """

    def __init__(
        self,
        channels: list[Channel] | None = None,
        timing: Timing | None = None,
        *,
        latency: float = 0.001,
        bitrate: int = 1_000_000,
        variants: Mapping[str, Variant] | None = None,
        **options: object,
    ) -> None:
        channels = channels or one_board()
        names = sorted({line.bus for c in channels for line in c.lines.values()})
        buses = tuple(BusWiring(name, "none", name, bitrate) for name in names)
        self.wiring = Wiring(buses, tuple(channels), **options)
        self.timing = timing or Timing()
        given = {str(board): STANDARD for board in self.wiring.boards} | dict(variants or {})
        late = {board: answering(variant, latency) for board, variant in given.items()}
        super().__init__(self.wiring, self.timing, self._to_master, late)
        for bus in self.buses.values():
            bus.log = []
        self.run, self.until, self.after = self.agenda.run, self.agenda.until, self.agenda.after
        self.stalled = False
        self.switched: list[tuple[int, float]] = []
        self._faults: list[ArmFault] = []
        self._waiting: list[Event] = []
        self.master: Any = None
        self.new_master()
        self.after(0.0, self._tick)

    def new_master(self) -> None:
        self.use(Master(self.wiring, self.timing, self.send))
        for name, bus in self.buses.items():
            self.master.receive_event(BusChanged(name, bus.state, "", None), self.now)

    def use(self, master: Any) -> None:
        """Replaces the master, which is killed, by another or a tool; it hears nothing that came before."""
        self._collect()
        self.master = master
        self._waiting.clear()

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
        if self.stalled:
            self._waiting.append(event)
        elif isinstance(event, SendFailed) and not isinstance(self.master, Master):
            self.master.send_failed(event.bus, event.frame, self.now)
        else:
            self.master.receive_event(event, self.now)
            self._collect()

    def say(self, cob_id: int, data: bytes = b"", bus: str = "can0") -> None:
        self.buses[bus].from_other(Frame(cob_id, data))

    def cycle_power(self, board: str) -> None:
        self.fault("power_cut", board)
        self.fault("power_on", board)

    def boot(self) -> World:
        self.run(0.05)  # the boards have long booted when the master comes
        self.master.boot(self.now)
        self.until(lambda: not self.master.booting)
        return self

    def up(self) -> World:
        self.boot()
        assert self.master.boot_faults == []
        assert self.master.outputs_known
        self.frames()
        return self

    def commit(self, *states: int, then: float = 0.0) -> None:
        """Commits, and runs until the commit has ended, and `then` [s] longer."""
        self.master.commit(bits(*states), self.now)
        self.until(lambda: not self.master.committing)
        if then:
            self.run(then)

    def commit_when_possible(self, *states: int) -> None:
        def taken() -> bool:
            try:
                self.commit(*states)
            except Busy:
                return False
            return self.master.commit_failed is None

        while not taken():
            self.run(TICK)

    def frames(self, bus: str = "can0", sdo: bool = False) -> list[tuple[int, str]]:
        """Returns COB-ID and data of the frames since the last call, without heartbeats, and without SDO by default."""
        log, self.buses[bus].log = self.buses[bus].log or [], []
        left_out = (cia301.HEARTBEAT,) if sdo else (cia301.HEARTBEAT, cia301.SDO_REQUEST, cia301.SDO_ANSWER)
        return [(frame.id, frame.data.hex(" ")) for frame in log if frame.id & 0x780 not in left_out]

    @property
    def faults(self) -> list[ArmFault]:
        self._collect()
        return self._faults

    def codes(self) -> list[str]:
        return [fault.code for fault in self.faults]

    def next_codes(self) -> list[str]:
        """Waits for a fault."""
        self.until(self.codes)
        return self.codes()

    def positions(self) -> list[float]:
        self._attached.step()
        return self.boards.positions()

    def switches(self) -> list[int]:
        return self.boards.switches()

    def measured(self) -> list[int]:
        """States, -1 where unknown."""
        states, known = measured(self.master, self.wiring), self.master.known
        return [states >> k & 1 if known >> k & 1 else -1 for k in range(len(self.wiring.channels))]

    def _collect(self) -> None:
        if isinstance(self.master, Master):
            self._faults += self.master.drain_faults()
            self.switched += self.master.drain_switched()


@functools.cache
def answering(variant: Variant, latency: float) -> Variant:
    return replace(variant, answer_delay=variant.answer_delay + latency)


def measured(master: Master, wiring: Wiring) -> int:
    """Returns the states of actuators with one output: the end-stop, else the output; 0 where unknown."""
    ended = sum(1 << k for k, channel in enumerate(wiring.channels) if channel.input is not None)
    everything = (1 << len(wiring.channels)) - 1
    return (master.ends & ended | master.outputs & ~ended) & everything & master.known


def bits(*states: int) -> int:
    return sum(state << k for k, state in enumerate(states))


def one_board() -> list[Channel]:
    return [Channel("5.left", "can0", 5, 0, 0), Channel("5.right", "can0", 5, 1, 1)]


def two_boards() -> list[Channel]:
    return [Channel("5.left", "can0", 5, 0, 0), Channel("9.left", "can0", 9, 3, 2)]


def two_buses() -> list[Channel]:
    return [Channel("a", "can0", 5, 0, 0), Channel("b", "can1", 5, 0, 0)]
