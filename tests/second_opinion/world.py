"""The executor on boards of another stack, with decoding of python-can's messages: one thread, one simulated clock."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import Any

import can

from hyperbit.controller.executor.arm.arm import ExecutedArm
from hyperbit.controller.executor.arm.switch_journal import SwitchJournal
from hyperbit.controller.executor.core.core import Executor
from hyperbit.controller.executor.core.events import ClientId, ExecutorTick, FromClient, SendFrame, ToClient
from hyperbit.controller.host.process import Log
from hyperbit.controller.program import (
    TICK,
    VERSION,
    Alive,
    Ended,
    Hello,
    Program,
    Reset,
    Snapshot,
    Stage,
    pack,
    unpack,
)
from hyperbit.drivers.canopen.wire.bus import CanBus
from hyperbit.drivers.canopen.wiring import BusWiring, Channel, Timing, Wiring
from tests.second_opinion.board import Board, Change
from tests.second_opinion.dictionary import MODULE, Kind

NODES = (1, 2)
FIRST = 7  # output of the first actuator of a board: its three outputs lie in both bytes
LABELS = tuple(f"{node}.{name}" for node in NODES for name in ("left", "diagonal", "right"))
SIZE = len(LABELS)
A, B = 0b000111, 0b011100
STEP = 0.002  # [s]
TIMING = Timing(heartbeat=0.1, heartbeat_timeout=0.35, boot_timeout=1.0, travel_time=0.05, settle_margin=0.03)
BUS = BusWiring("can0", "virtual", "second opinion")
CHANNELS = tuple(Channel(label, "can0", NODES[k // 3], FIRST + k % 3, FIRST + k % 3) for k, label in enumerate(LABELS))
PLANNER = ClientId(1, 4001)
BUS_OFF, RESTARTED = 0x40, 0x100  # error frames of SocketCAN


class Cable:
    """The interface of python-can that the executor opens; the other end is the world's.

    Attributes:
        waiting: messages that the executor has not read yet.
        off: whether the executor's controller is bus-off: no frame passes.
    """

    def __init__(self, sent: Callable[[int, bytes], None]) -> None:
        self.waiting: deque[can.Message] = deque()
        self.off, self._sent = False, sent

    def send(self, message: can.Message) -> None:
        if self.off:
            raise can.CanOperationError("No buffer space available", error_code=105)
        message.is_rx = False
        self.waiting.append(message)
        self._sent(message.arbitration_id, bytes(message.data))

    def recv(self, timeout: float) -> can.Message | None:
        return self.waiting.popleft() if self.waiting else None

    def hear(self, cob_id: int, data: bytes) -> None:
        if not self.off:
            self.waiting.append(can.Message(arbitration_id=cob_id, data=data, is_extended_id=False))

    def go(self, off: bool) -> None:
        """Makes the controller bus-off, or restarts it."""
        self.off = off
        kind = BUS_OFF if off else RESTARTED
        self.waiting.append(can.Message(arbitration_id=kind, is_error_frame=True, data=bytes(8)))


class World:
    """Two boards and an executor, which may be killed, stopped and started again.

    Attributes:
        now: [s].
        changes: each change of the pins, with the executor's mode at that time.
        answers: whether the boards' SDO answers reach the executor.
        in_mid_boot: called once, when the executor has sent its first NMT command or 60 frames since its start.
    """

    def __init__(self, kind: Kind = MODULE, **wiring: Any) -> None:
        self.now = 50.0
        self.arm = ExecutedArm("second", Wiring((BUS,), CHANNELS, **wiring), TIMING, digest="d" * 64)
        self.changes: list[tuple[str, Change]] = []
        self.journal = SwitchJournal(SIZE)
        self.core: Executor | None = None
        self.cable = Cable(self._from_executor)
        self.answers, self.instances, self.programs = True, 0, 0
        self.heard: list[Any] = []
        self.logged: list[str] = []
        self.in_mid_boot: Callable[[], None] | None = None
        self._frames = 0
        self.boards = {node: Board(node, kind, self._from_board, self._changed) for node in NODES}

    def start(self) -> None:
        """Starts an executor; nothing of an earlier one remains but the switch journal."""
        self.instances += 1
        self.heard.clear()
        self._frames = 0
        self.cable = Cable(self._from_executor)
        self.wire = CanBus(BUS, lambda: self.now, lambda **_: self.cable)
        self.wire.open()
        self.core = Executor(self.arm, self.journal, instance=self.instances)
        self.send(Hello(VERSION, "planner", self.arm.name))

    def kill(self) -> None:
        self.core = None

    def stall(self, seconds: float) -> None:
        """Stops the executor's process for a time; what the bus brings waits in its socket."""
        core, self.core = self.core, None
        self.go(seconds)
        self.core = core

    def go(self, seconds: float) -> None:
        for k in range(round(seconds / STEP)):
            self.now += STEP
            for board in self.boards.values():
                board.step(self.now)
            if self.core is not None:
                self._poll()
                if k % round(TICK / STEP) == 0:
                    self.send(Alive())
                    self._do(ExecutorTick())

    def until(self, mode: str, seconds: float = 20.0) -> None:
        end = self.now + seconds
        while self.mode != mode:
            assert self.now < end, f"not {mode} but {self.mode}: {self.logged[-5:]}"
            self.go(TICK)

    def up(self) -> World:
        self.start()
        self.until("ready")
        self.go(0.5)
        return self

    def _poll(self) -> None:
        while events := self.wire.poll():
            for event in events:
                self._do(event)

    def _do(self, event: Any) -> None:
        if self.core is None:
            return
        for action in self.core.step(event, self.now):
            match action:
                case SendFrame():
                    self.wire.send_frame(action.frame)
                case ToClient():
                    self.heard.append(action.message)
                case Log():
                    self.logged.append(action.text)
        self._poll()

    def send(self, message: Any) -> None:
        self._do(FromClient(PLANNER, message))

    def run(self, *states: int, step: float = 0.3) -> None:
        self.programs += 1
        snapshot = self.last(Snapshot)
        stages = tuple(Stage(pack(bits, SIZE), at=step * k, mark=k) for k, bits in enumerate(states))
        name = f"goal {self.programs}"
        self.send(Program(self.programs, snapshot.epoch, snapshot.outputs, 0.0, stages, True, False, name))

    def done(self, *states: int) -> None:
        """Runs a program to its end, and compares pins and measured states."""
        self.go(0.2)
        self.run(*states)
        self.go(0.3 * len(states) + 0.3)
        ended = self.last(Ended)
        assert (ended.status, unpack(ended.measured), self.pins) == ("done", states[-1], states[-1]), self.logged[-5:]

    def reset(self) -> None:
        """Resets unless the arm is ready by itself."""
        if self.core is not None and self.mode != "ready":
            self.send(Reset(1, self.core.modes.epoch))
        self.go(TICK)
        self.until("ready")

    def last(self, kind: type) -> Any:
        return next(message for message in reversed(self.heard) if isinstance(message, kind))

    @property
    def mode(self) -> str:
        return "dead" if self.core is None else self.core.modes.mode

    def foreign(self, cob_id: int, data: bytes) -> None:
        """Sends a frame of another program."""
        self.cable.hear(cob_id, data)
        self._to_boards(cob_id, data)

    def _from_executor(self, cob_id: int, data: bytes) -> None:
        self._to_boards(cob_id, data)
        self._frames += 1
        if self.in_mid_boot and (cob_id == 0 or self._frames >= 60):
            strike, self.in_mid_boot = self.in_mid_boot, None
            strike()

    def _to_boards(self, cob_id: int, data: bytes) -> None:
        for board in self.boards.values():
            board.receive(cob_id, data, self.now)

    def _from_board(self, cob_id: int, data: bytes) -> None:
        if self.answers or cob_id & 0x780 != 0x580:
            self.cable.hear(cob_id, data)

    @property
    def pins(self) -> int:
        return sum((board.pins >> FIRST & 7) << 3 * k for k, board in enumerate(self.boards.values()))

    def _changed(self, change: Change) -> None:
        self.changes.append((self.mode, change))

    def causes(self) -> list[str]:
        """Returns the causes of the changes since the last call; no START changes a pin, only SYNC energises one."""
        changes, self.changes = self.changes, []
        for mode, it in changes:
            shown = f"{it.cause} changed node {it.node} from {it.before:04X}h to {it.after:04X}h in {mode}"
            assert it.cause != "START", shown
            assert not it.energised or (it.cause, mode) == ("SYNC", "executing"), shown
        return [change.cause for _, change in changes]
