"""A master and one board on one CAN bus, on a simulated clock. Copies of a rig are cheap."""

from __future__ import annotations

import heapq
import io
import pickle
import struct
from collections.abc import Callable
from typing import NamedTuple, Protocol

from hyperbit.drivers.canopen.run.master import Master
from hyperbit.drivers.canopen.wire import cia301
from hyperbit.drivers.canopen.wire.cia301 import Command, Frame
from hyperbit.drivers.canopen.wire.events import BusChanged, FrameEchoed, FrameReceived
from hyperbit.drivers.canopen.wiring import Timing, Wiring
from hyperbit.drivers.simulation.buses import build_actuator, wire
from hyperbit.drivers.simulation.firmware import SimulatedBoard
from hyperbit.drivers.simulation.variants import Variant

BUS, BITRATE, NODE = "can0", 1_000_000, 5
TICK, LATENCY = 0.01, 0.001  # [s] of the master, and of an SDO answer
MASTER, BOARD, TOOL = "master", "board", "another program"  # senders of frames


class PinChange(NamedTuple):
    """Masks of the output pins that came on or went off.

    `cause` is "START", another frame, "time" or "supply"; `sender` sent the frame.
    """

    on: int
    off: int
    cause: str
    sender: str
    commanded: bool


class Interception(Protocol):
    def delays(self, sender: str, frame: Frame) -> tuple[float, ...]:
        """Returns the delay of each delivery of a frame [s]; none: the frame is lost."""

    def delivered(self, rig: Rig) -> None:
        """Is called after a frame was delivered."""


class Rig:
    """One board, its bus, and a master, which can be exchanged.

    Attributes:
        now: time [s].
        master: the present master; None: no executor runs.
        stalled: whether the executor stands still; frames and echoes wait for it.
        off: whether the controller of the master is bus-off.
        log: frames on the bus since the last boot began, with their senders.
        changes: changes of the pins since the last boot began.
        interception: sees each frame; None: none does.
    """

    def __init__(self, wiring: Wiring, timing: Timing, variant: Variant) -> None:
        self.now = 0.0
        self.wiring, self.timing, self.variant = wiring, timing, variant
        actuators = {channel.actuator: build_actuator(channel, timing) for channel in wiring.channels}
        [wired] = wire(wiring, actuators).values()
        self.board = SimulatedBoard(wiring.channels[0].node, wired, self._from_board, variant)
        self.master: Master | None = None
        self.off = self.stalled = self._commanded = False
        self.log: list[tuple[str, Frame]] = []
        self.changes: list[PinChange] = []
        self.interception: Interception | None = None
        self._waiting: list[tuple[str, Frame]] = []  # for a stalled master
        self._queue: list[tuple[float, int, str, Frame]] = []
        self._number, self._free, self._next_tick = 0, 0.0, TICK
        self._pins = 0
        self.board.power_on(0.0)

    def run(self, seconds: float) -> None:
        self.until(lambda: False, seconds)

    def until(self, condition: Callable[[], object], longest: float) -> bool:
        """Runs until a condition holds, at most `longest` [s]; returns whether it holds."""
        end = self.now + longest
        while not condition():
            frame_due = self._queue[0][0] if self._queue else end
            board_due = self.board.timer
            due = min(frame_due, self._next_tick, board_due)
            if due > end or (due == end and not self._queue):
                self.now = end
                return bool(condition())
            self.now = max(due, self.now)
            if self._queue and frame_due <= self.now:
                _, _, sender, frame = heapq.heappop(self._queue)
                self._deliver(sender, frame)
            elif board_due <= self.now:
                self.board.step(self.now)
                self._look("time", "")
            else:
                self._next_tick = self.now + TICK
                if self.master is not None and not self.stalled:
                    self.master.tick(self.now)
        return True

    def start_master(self) -> Master:
        self.master = Master(self.wiring, self.timing, self._from_master)
        self.master.receive_event(BusChanged(BUS, "bus-off" if self.off else "active", "", None), self.now)
        return self.master

    def go_on(self) -> None:
        self.stalled = False
        if self.master is not None:
            self.master.tick(self.now)
        waiting, self._waiting = self._waiting, []
        for sender, frame in waiting:
            self._tell(sender, frame)

    def boot(self) -> None:
        assert self.master is not None
        self.master.boot(self.now)

    def commit(self, states: int) -> None:
        """Switches all lines; returns after the travel of their actuators."""
        assert self.master is not None
        self._commanded = True
        self.master.commit(states, self.now)
        assert self.until(lambda: self.master is not None and not self.master.committing, 10.0)
        assert self.master.commit_failed is None
        assert self.lines == states
        self.run(2 * self.timing.travel_time)
        self._commanded = False

    def set_bus(self, state: str) -> None:
        """Changes the state of the master's controller; frames that it holds are lost."""
        self.off = state != "active"
        if self.off:
            self._queue = [entry for entry in self._queue if entry[2] != MASTER]
            heapq.heapify(self._queue)
        if self.master is not None:
            self.master.receive_event(BusChanged(BUS, state, "", None), self.now)

    @property
    def lines(self) -> int:
        """Levels of the output lines that the pins have."""
        pins = self.board.pins
        return sum((pins >> line.bit & 1 ^ line.inverted) << k for k, line in enumerate(self.wiring.output_lines))

    def write(self, index: int, sub: int, value: int) -> None:
        self._put(TOOL, Frame(cia301.SDO_REQUEST + NODE, struct.pack("<BHBI", 0x2F, index, sub, value)), 0.0)

    def command(self, command: Command) -> None:
        self._put(TOOL, Frame(cia301.NMT, bytes([command, 0])), 0.0)

    def power_cycle(self) -> None:
        self.board.power_cut(self.now)
        self._look("supply", "")
        self.board.power_on(self.now)
        self._look("supply", "")

    def _from_master(self, bus: str, frame: Frame) -> None:
        if not self.off:
            self._put(MASTER, frame, 0.0)

    def _from_board(self, cob_id: int, data: bytes) -> None:
        answer = cob_id & 0x780 == cia301.SDO_ANSWER
        self._put(BOARD, Frame(cob_id, data), LATENCY if answer else 0.0)

    def _put(self, sender: str, frame: Frame, delay: float) -> None:
        self._free = max(self._free, self.now + delay) + cia301.wire_bits(len(frame.data)) / BITRATE
        self._push(self._free, sender, frame)

    def _push(self, at: float, sender: str, frame: Frame) -> None:
        self._number += 1
        heapq.heappush(self._queue, (at, self._number, sender, frame))

    def _deliver(self, sender: str, frame: Frame) -> None:
        self.log.append((sender, frame))
        if sender == MASTER:
            self._tell(sender, frame)
        seen = self.interception
        for delay in (0.0,) if seen is None else seen.delays(sender, frame):
            if delay:
                self._push(self.now + delay, sender, frame)
                self.log.pop()
            else:
                self._hear(sender, frame)
        if seen is not None:
            seen.delivered(self)

    def _hear(self, sender: str, frame: Frame) -> None:
        if sender != BOARD:
            if self.board.timer <= self.now:
                self.board.step(self.now)
                self._look("time", "")
            self.board.receive(*frame, self.now)
            self._look(_words(frame), sender)
        if sender != MASTER and not self.off:
            self._tell(sender, frame)

    def _tell(self, sender: str, frame: Frame) -> None:
        """Gives the master a frame, or the echo of its own."""
        if self.stalled:
            self._waiting.append((sender, frame))
        elif self.master is not None:
            event = FrameEchoed if sender == MASTER else FrameReceived
            self.master.receive_event(event(BUS, frame, None), self.now)

    def _look(self, cause: str, sender: str) -> None:
        after = self.board.pins
        if after != self._pins:
            on, off = after & ~self._pins, self._pins & ~after
            self.changes.append(PinChange(on, off, cause, sender, self._commanded))
            self._pins = after


def _words(frame: Frame) -> str:
    if frame.id == cia301.NMT:
        return "START" if frame.data[:1] == bytes([Command.START]) else f"NMT {frame.data.hex()}"
    return f"frame {frame.id:03X}h"


class Copies:
    def __init__(self, rig: Rig) -> None:
        assert rig.master is None
        self._shared = [rig.variant, rig.variant.objects, rig.wiring, rig.timing]  # they never change
        places = {id(shared): place for place, shared in enumerate(self._shared)}
        buffer = io.BytesIO()
        pickler = _Pickler(buffer, pickle.HIGHEST_PROTOCOL)
        pickler.places = places
        pickler.dump(rig)
        self._bytes = buffer.getvalue()

    def copy(self) -> Rig:
        unpickler = _Unpickler(io.BytesIO(self._bytes))
        unpickler.shared = self._shared
        rig: Rig = unpickler.load()
        return rig


class _Pickler(pickle.Pickler):
    places: dict[int, int]

    def persistent_id(self, obj: object) -> int | None:
        return self.places.get(id(obj))


class _Unpickler(pickle.Unpickler):
    shared: list[object]

    def persistent_load(self, pid: int) -> object:
        return self.shared[pid]
