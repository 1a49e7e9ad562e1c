"""An executor with its boards of the simulation, a planner, an operator, and an intruder on the bus.

An input advances the time by what its frames and ticks take, so that runs reproduce.
"""

from __future__ import annotations

from dataclasses import replace
from random import Random
from typing import Any, Literal

import can

from hyperbit.controller.executor.core.core import Executor
from hyperbit.controller.executor.core.events import ClientGone, ClientId, Event, FromClient
from hyperbit.controller.program import (
    TICK,
    VERSION,
    Alive,
    Cancel,
    Down,
    Goodbye,
    Hello,
    Lock,
    Reset,
    Stop,
    Up,
)
from hyperbit.drivers.canopen.run.master import Master
from hyperbit.drivers.canopen.wire import cia301
from hyperbit.drivers.canopen.wire.bus import CanBus
from hyperbit.drivers.canopen.wire.cia301 import Frame
from hyperbit.drivers.canopen.wire.events import Event as BusEvent
from hyperbit.drivers.canopen.wire.events import FrameIgnored, FrameReceived
from hyperbit.drivers.canopen.wiring import BusWiring, Channel, Timing, Wiring
from tests.executor.rig import LABELS, SIZE, small_arm
from tests.fuzz.judge import Judge, Moved, Wedged
from tests.simulation.buses.boards import Hardware
from tests.simulation.buses.bus_model import OnItsWay
from tests.simulation.executor.process import WAKE_UP, ExecutorProcess
from tests.simulation.statements.statement import Witness

NODES = (5, 9)
TRAVEL = 0.02
TIMING = Timing(heartbeat=0.02, heartbeat_timeout=0.07, boot_timeout=0.1, travel_time=TRAVEL)
BUS = BusWiring("can0", "virtual", "fuzz")
CHANNELS = tuple(
    Channel(label, "can0", NODES[k // 3], k % 3, None if k == 5 else k % 3) for k, label in enumerate(LABELS)
)
RPDOS = tuple(cia301.RPDO1 + node for node in NODES)
TPDOS = tuple(cia301.TPDO1 + node for node in NODES)
# What boards obey, whoever sends it.
COMMANDS = {cia301.NMT, cia301.SYNC, *RPDOS, *(cia301.SDO_REQUEST + node for node in NODES)}
PLANNER, OPERATOR = ClientId(1, 4001), ClientId(2, 4002)


HEARD_WITHIN = cia301.wire_bits(8) / BUS.bitrate + WAKE_UP  # [s], from a frame on the free bus to its end


class Decoder(CanBus):
    """The decoding of python-can's messages by the executor's bus, one message at a time."""

    def __init__(self, settings: BusWiring) -> None:
        super().__init__(settings)
        self._message: can.Message | None = None
        self.open()
        self.poll()

    def decode(self, it: can.Message) -> list[BusEvent]:
        self._message = it
        return list(self.poll())

    def _open(self) -> Any:
        return self

    def recv(self, timeout: float) -> can.Message | None:
        message, self._message = self._message, None
        return message


class World(Hardware, Witness):
    """One arm of two boards with executor, bus, planner, and an intruder on the bus.

    Attributes:
        dirty: whether the intruder may have commanded the boards.
    """

    def __init__(self) -> None:
        self.arm = replace(small_arm(), wiring=Wiring((BUS,), CHANNELS), timing=TIMING)
        super().__init__(self.arm.wiring, TIMING, lambda event: self.executor.post(event))
        self.judge = Judge(self.arm.wiring)
        self.boots = self.lines = 0
        self.last, self.dirty = "", True
        self._decoder, self._random = Decoder(BUS), Random(0)
        self._answers: list[tuple[int, int, bytes]] = []
        self._booting = False
        self._event: Event | None = None
        self._turned_away: list[ClientId] = []
        self.executor = ExecutorProcess(self.arm, self.agenda, self._random, self.buses, self)
        self.executor.connect(self._hear, lambda: None)
        self.executor.start()
        self._greet(PLANNER)
        self._greet(OPERATOR)
        self._keep_alive()
        self.recover()

    @property
    def core(self) -> Executor:
        assert self.executor.core is not None
        return self.executor.core

    @property
    def master(self) -> Master:
        return self.core.master

    def told(self, event: Event) -> None:
        self._end_event()
        self._event, self._before = event, (self.core.motion.readings.read, self.master.inputs.known)
        self.judge.begin()
        if isinstance(event, FromClient) and event.client == PLANNER:
            self.judge.proposed(event.message)

    def _end_event(self) -> None:
        event, self._event = self._event, None
        if event is None:
            return
        measured, known = self.core.motion.readings.read, self.master.inputs.known
        if isinstance(event, FrameIgnored) and (measured, known) != self._before:
            raise AssertionError(f"taken for the state of a board: {event}")
        too_short = isinstance(event, FrameReceived) and event.frame.id in TPDOS and not event.frame.data
        if too_short and measured != self._before[0]:
            raise AssertionError(f"taken for inputs: {event}")
        self.boots += self.master.booting.under_way and not self._booting
        self._booting = self.master.booting.under_way
        self.judge.end(self.core.modes.mode == "executing")

    def sends(self, bus: str, frame: Frame) -> None:
        self.judge.judge(frame, self.core, lambda node: self.boards.board(f"can0/{node}").pins)

    def logs(self, level: int, text: str) -> None:
        self.lines += 1
        self.last = text
        assert "internal error" not in text, text

    def _hear(self, client: ClientId, message: Up) -> None:
        if isinstance(message, Goodbye):
            self._turned_away.append(client)
        elif client == PLANNER:
            self.judge.heard(message)

    def go(self, ticks: int = 1) -> None:
        """Advances the time of all parts by a number of periods."""
        self.agenda.run(ticks * TICK)
        self._end_event()

    def _keep_alive(self) -> None:
        self.executor.hear(PLANNER, FromClient(PLANNER, Alive()))
        self.agenda.after(TICK, self._keep_alive)

    def _greet(self, client: ClientId) -> None:
        role: Literal["planner", "operator"] = "planner" if client == PLANNER else "operator"
        self.executor.hear(client, FromClient(client, Hello(VERSION, role, self.arm.name)))

    def send(self, message: Down, client: ClientId = PLANNER) -> None:
        self.executor.hear(client, FromClient(client, message))
        self.agenda.run(WAKE_UP)
        gone, self._turned_away = self._turned_away, []
        for one in gone:
            self.executor.hear(one, ClientGone(one))
            self._greet(one)
        self.agenda.run(WAKE_UP)
        self._end_event()

    def attack(self, it: can.Message) -> None:
        standard = not (it.is_extended_id or it.is_remote_frame or it.is_error_frame or it.is_fd)
        events = self._decoder.decode(it)
        if standard != any(isinstance(event, FrameReceived) for event in events):
            raise AssertionError(f"taken for {events}: {it}")
        for event in events:
            if isinstance(event, FrameReceived):
                self.dirty |= event.frame.id in COMMANDS
                self.buses["can0"].from_other(event.frame)
            else:
                self.executor.post(event)
        self.agenda.run(HEARD_WITHIN)
        self._end_event()

    def arm_ambush(self, mode: int, index: int, data: bytes) -> None:
        """Queues an SDO answer of the intruder to the master's next request for an object; 0: any object."""
        self._answers.append((mode, index, data))

    def _to_boards(self, bus: str, sent: OnItsWay, lost: bool) -> None:
        """Delivers a frame to the boards; the intruder may answer before them or instead of them."""
        frame = sent.frame
        if self._answers and frame.id & 0x780 == cia301.SDO_REQUEST and frame.data[:1] not in (b"", b"\x80"):
            asked = int.from_bytes(frame.data[1:3], "little")
            place = next((k for k, (_, index, _) in enumerate(self._answers) if index in (0, asked)), None)
            if place is not None:
                mode, _, data = self._answers.pop(place)
                if mode & 1:  # an answer to the question
                    data = data[:1] + frame.data[1:4] + data[4:]
                self.dirty = True  # the master may believe that the outputs are others
                self.buses[bus].from_other(Frame(frame.id - cia301.SDO_REQUEST + cia301.SDO_ANSWER, data))
                lost = bool(mode & 2)
        super()._to_boards(bus, sent, lost)

    def supply(self, node: int, on: bool) -> None:
        self.dirty = True
        self.fault("power_on" if on else "power_cut", f"can0/{node}")

    def check_outputs(self) -> None:
        """Compares the boards' outputs with the master's commands, unless the intruder commanded them."""
        for _ in range(5):
            drives = sum(drive << k for k, drive in enumerate(self.boards.drives()))
            if self.dirty or drives == self.master.outputs.commanded:
                return
            self.agenda.run(HEARD_WITHIN)
        raise Moved(f"the outputs are {drives:06b}, switched to {self.master.outputs.commanded:06b}")

    def recover(self) -> None:
        """Removes all faults, resets, and checks that the arm becomes ready."""
        self._answers.clear()
        if self.dirty:
            for node in NODES:
                self.supply(node, on=False)
                self.supply(node, on=True)
            self.go(8)
        self.buses["can0"].restart()
        self.send(Cancel(1, None, "over"))
        self.go(12)
        for k in range(SIZE):
            self.send(Lock(2, k, -1))
        if self.core.modes.mode != "ready":
            self.send(Stop(3))
            self.send(Reset(4, self.core.modes.epoch))
            self.go(15)
        self.judge.clear()
        if self.core.modes.mode != "ready":
            raise Wedged(f"{self.core.modes.mode} after a reset: {self.core.modes.reason}")
        self.dirty = False
        self.check_outputs()
        self.agenda.run(self.executor._next_tick - self.now)
        self._random.seed(0)  # an input finds the same delays at each run
