"""A CANopen master without buses, for tests of the executor."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

from hyperbit.drivers.canopen.boards.board import InputLines
from hyperbit.drivers.canopen.boards.outputs import OutputLines
from hyperbit.drivers.canopen.faults import ArmFault, Busy, FaultLog
from hyperbit.drivers.canopen.layout import lay_out
from hyperbit.drivers.canopen.status import MasterStatus
from hyperbit.drivers.canopen.wiring import Interlock, Timing, Wiring


class FakeErrorReads:
    def __init__(self) -> None:
        self.asked: list[int] = []
        self.told: list[Any] = []
        self.ask = self.asked.append

    def drain(self) -> list[Any]:
        told, self.told = self.told, []
        return told


class FakeInputs(InputLines):
    """Input lines that may be read with an exception."""

    def __init__(self, look: Callable[[], None]) -> None:
        super().__init__()
        self._look = look

    @property
    def ends(self) -> int:
        self._look()
        return super().ends


class FakeSwitching:
    """Attributes as of `OutputSwitching`; what leaves is `target`."""

    def __init__(self, outputs: OutputLines) -> None:
        self.under_way = self.collecting = self.releasing = False
        self.target = self.partly = 0  # levels after the commit; mask of lines that a SYNC does not switch
        self.failed: str | None = None
        self.switched: list[tuple[int, float]] = []
        self._outputs = outputs

    @property
    def leaving(self) -> int:
        changed = (self._outputs.commanded ^ self.target) & ~self.partly
        return changed if self.under_way and not self.collecting else 0

    def give_up(self, why: str) -> None:
        if self.collecting and not self.releasing:
            self.under_way = self.collecting = False
            self.failed = why

    def drain(self) -> list[tuple[int, float]]:
        switched, self.switched = self.switched, []
        return switched


class FakeMaster:
    """A master without buses: a commit is sent with the next event, and the end-stops follow a travel time later.

    Outputs and inputs are lines in the order of `Wiring`; no pulse is read back. An end-stop reads 1 only while its
    actuator is at that end.
    """

    resting = False  # it wants each tick

    def __init__(self, wiring: Wiring, timing: Timing, send: Any) -> None:
        nodes = wiring.boards
        self.board_of = tuple(nodes.index(c.lines["output"].board) for c in wiring.channels)
        ends = [[line.board for name, line in c.lines.items() if name.startswith("input")] for c in wiring.channels]
        self.input_boards_of = tuple(tuple(sorted({nodes.index(board) for board in boards})) for boards in ends)
        self.rest = lambda period: None
        self._wiring, self._size = wiring, len(wiring.channels)
        self.outputs, self.inputs = OutputLines(lay_out(wiring), 0), FakeInputs(lambda: self._break("ends"))
        for i in range(len(wiring.input_lines) - self._size):  # contracted ends, closed interlocks
            self.inputs.levels |= 1 << self._size + i
        self.all, self._travel = (1 << self._size) - 1, timing.travel_time
        self.silent: dict[str, str] = {}  # why the objects of interlocks are unknown, by name
        self.back = False
        self.answers = True
        self.booting, self.boots_long = SimpleNamespace(under_way=False, faults=list[ArmFault]()), False
        self.boot_faults: list[ArmFault] = []  # of the next boots
        self.boards = [SimpleNamespace(boots=0, questioning=False) for _ in nodes]
        self.booted = 0
        self.limits: tuple[ArmFault, ...] = ()
        self.switching, self.faults = FakeSwitching(self.outputs), FaultLog()
        self.commits: list[tuple[float, int]] = []
        self.questions: list[tuple[int, float]] = []
        self.busy = False
        self.slow_rpdos = self.slow_sync = False  # RPDOs wait, or the SYNC was handed out and is not sent yet
        self.stuck = 0  # mask of stuck actuators
        self.halfway = 0  # mask of actuators that stop halfway
        self.pause: ArmFault | None = None
        self.broken: set[str] = set()
        self.ticks: list[float] = []
        self.left: list[tuple[float, int]] = []  # when which lines were switched
        self.targets = 0  # states that the actuators go to
        self._arrivals: list[tuple[float, int, int]] = []
        self.errors = FakeErrorReads()

    def receive_event(self, event: Any, now: float) -> None:
        self._break("receive_event")

    def tick(self, now: float) -> None:
        self.ticks.append(now)
        self._break("tick")
        if self.booting.under_way and not self.boots_long:
            self.booting.under_way, self.booting.faults = False, list(self.boot_faults)
            self._know(0 if self.boot_faults else self.all)
        for due, k, state in list(self._arrivals):
            if now >= due - 1e-9:
                if not (self.stuck | self.halfway) >> k & 1:
                    self._reads(k, state, 1)
                self._arrivals.remove((due, k, state))
        for board in self.boards if self.answers else ():
            board.questioning = False
        if not (self.slow_rpdos or self.slow_sync):
            self.leave(now)

    def leave(self, now: float) -> None:
        switching = self.switching
        if switching.under_way:
            switching.under_way = switching.collecting = False
            mask = (self.outputs.commanded ^ switching.target) & ~switching.partly
            self.outputs.commanded ^= mask
            switching.failed = "one bus failed" if switching.partly else None
            switching.switched.append((mask, now))
            self._drive(now)
            if mask:
                self.left.append((now, mask))

    def _drive(self, now: float) -> None:
        """Moves the actuators as their outputs command; with both outputs off, an actuator continues its motion."""
        commanded = self.outputs.commanded
        for k, channel in enumerate(self._wiring.channels):
            on, state = commanded >> k & 1, self.targets >> k & 1
            if channel.output_off is not None:
                off = commanded >> self._size + self._wiring.paired.index(k) & 1
                assert not on & off, "both outputs are on"
                on = on if on or off else state
            if on != state:
                self.targets ^= 1 << k
                self._arrivals = [arrival for arrival in self._arrivals if arrival[1] != k]
                self._arrivals.append((now + 0.8 * (channel.travel or (self._travel,) * 2)[on], k, on))
                if not self.stuck >> k & 1:
                    self._reads(k, 1 - on, 0)

    def _reads(self, k: int, end: int, level: int) -> None:
        channel, line = self._wiring.channels[k], k
        if (channel.input if end else channel.input_contracted) is None:
            return
        if not end:
            line = self._size + self._wiring.ended.index(k)
        self.inputs.levels = self.inputs.levels & ~(1 << line) | level << line

    def _know(self, actuators: int) -> None:
        self.inputs.known = actuators
        self.inputs.up = (1 << len(self._wiring.input_lines)) - 1 if actuators else 0

    def find_pause(self, now: float) -> ArmFault | None:
        pause, self.pause = self.pause, None
        return pause

    def boot(self, now: float) -> None:
        self._break("boot")
        self.booted += 1
        self.booting.under_way = True
        self.switching.under_way = self.switching.collecting = False
        self.faults.clear()

    def commit(self, outputs: int, now: float) -> None:
        self._break("commit")
        if self.busy or self.switching.under_way:
            raise Busy("the queue is full")
        self.commits.append((now, outputs))
        self._begin(outputs, False, now)

    def release(self, off: int, now: float) -> None:
        if not (self.busy or self.switching.under_way):
            self._begin(self.outputs.commanded & ~off, True, now)

    def _begin(self, outputs: int, releasing: bool, now: float) -> None:
        it = self.switching
        it.target, it.under_way, it.collecting, it.releasing = outputs, True, self.slow_rpdos, releasing
        if not (self.slow_rpdos or self.slow_sync):
            self.leave(now)

    def question(self, board: int, now: float) -> None:
        self.questions.append((board, now))
        self.boards[board].questioning = True

    def probe_silent(self, now: float) -> None:
        pass

    @property
    def outputs_known(self) -> bool:
        return self.inputs.known == self.all and not self.switching.under_way

    def unanswered(self, lock: Interlock) -> str | None:
        return self.silent.get(lock.name)

    def fail(self, fault: ArmFault, lost: int = 0) -> None:
        self.faults.report(fault)
        self._know(self.inputs.known & ~lost)

    def warnings(self) -> tuple[ArmFault, ...]:
        return self.limits

    def status(self) -> MasterStatus:
        return MasterStatus((), ())

    def _break(self, verb: str) -> None:
        if verb in self.broken:
            raise RuntimeError(f"{verb} is broken")
