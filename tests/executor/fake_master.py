"""A CANopen master without buses, for tests of the executor."""

from __future__ import annotations

from typing import Any

from hyperbit.drivers.canopen.faults import ArmFault, Busy
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


class FakeMaster:
    """A master without buses: a commit is sent with the next event, and the end-stops follow a travel time later.

    Outputs and inputs are lines in the order of `Wiring`. An end-stop reads 1 only while its actuator is at that end.
    """

    resting = False  # it wants each tick

    def __init__(self, wiring: Wiring, timing: Timing, send: Any) -> None:
        nodes = wiring.boards
        self.board_of = tuple(nodes.index(c.lines["output"].board) for c in wiring.channels)
        ends = [[line.board for name, line in c.lines.items() if name.startswith("input")] for c in wiring.channels]
        self.input_boards_of = tuple(tuple(sorted({nodes.index(board) for board in boards})) for boards in ends)
        self.rest = lambda period: None
        self.believe = lambda ends: None
        self.verification = self
        self._wiring, self._size = wiring, len(wiring.channels)
        self.outputs = self.inputs = self.doubtful = self.released = 0
        self.unread = self.missed = 0  # masks of lines that were not read back, and of missed pulses
        for i in range(len(wiring.input_lines) - self._size):  # contracted ends, closed interlocks
            self.inputs |= 1 << self._size + i
        self.all, self._travel = (1 << self._size) - 1, timing.travel_time
        self.up = self.answers = True
        self.silent: dict[str, str] = {}  # why the objects of interlocks are unknown, by name
        self.back = False
        self.known = 0
        self.booting = self.committing = self.collecting = self.boots_long = False
        self.boots = (0,) * len(nodes)
        self.booted = 0
        self.boot_faults: list[ArmFault] = []
        self.limits: tuple[ArmFault, ...] = ()
        self.commit_failed: str | None = None
        self.commits: list[tuple[float, int]] = []
        self.questions: list[tuple[int, float]] = []
        self.busy = False
        self.slow_rpdos = self.slow_sync = False  # RPDOs wait, or the SYNC was handed out and is not sent yet
        self.releasing = False
        self.stuck = self.partly = 0  # masks of stuck actuators, and of lines that a SYNC does not switch
        self.halfway = 0  # mask of actuators that stop halfway
        self.pause: ArmFault | None = None
        self.broken: set[str] = set()
        self.ticks: list[float] = []
        self.left: list[tuple[float, int]] = []  # when which lines were switched
        self.targets = 0  # states that the actuators go to
        self._target = 0
        self._arrivals: list[tuple[float, int, int]] = []
        self._faults: list[ArmFault] = []
        self._switched: list[tuple[int, float]] = []
        self._asked: set[int] = set()
        self.errors = FakeErrorReads()

    def receive_event(self, event: Any, now: float) -> None:
        self._break("receive_event")

    def tick(self, now: float) -> None:
        self.ticks.append(now)
        self._break("tick")
        if self.booting and not self.boots_long:
            self.booting = False
            self.known = 0 if self.boot_faults else self.all
        for due, k, state in list(self._arrivals):
            if now >= due - 1e-9:
                if not (self.stuck | self.halfway) >> k & 1:
                    self._reads(k, state, 1)
                self._arrivals.remove((due, k, state))
        if self.answers:
            self._asked.clear()
        if not (self.slow_rpdos or self.slow_sync):
            self.leave(now)

    def leave(self, now: float) -> None:
        if self.committing:
            self.committing = self.collecting = False
            mask = (self.outputs ^ self._target) & ~self.partly
            self.outputs ^= mask
            self.commit_failed = "one bus failed" if self.partly else None
            self._switched.append((mask, now))
            self._drive(now)
            if mask:
                self.left.append((now, mask))

    def _drive(self, now: float) -> None:
        """Moves the actuators as their outputs command; with both outputs off, an actuator continues its motion."""
        for k, channel in enumerate(self._wiring.channels):
            on, state = self.outputs >> k & 1, self.targets >> k & 1
            if channel.output_off is not None:
                off = self.outputs >> self._size + self._wiring.paired.index(k) & 1
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
        self.inputs = self.inputs & ~(1 << line) | level << line

    def find_pause(self, now: float) -> ArmFault | None:
        pause, self.pause = self.pause, None
        return pause

    def boot(self, now: float) -> None:
        self._break("boot")
        self.booted += 1
        self.booting, self.committing, self.collecting = True, False, False
        self._faults.clear()

    def commit(self, outputs: int, now: float, release: bool = False) -> None:
        self._break("commit")
        if release and (self.busy or self.committing):
            return
        if self.busy or self.committing:
            raise Busy("the queue is full")
        assert not release or outputs == outputs & self.outputs, "a release switches something on"
        if not release:
            self.commits.append((now, outputs))
        self._target, self.committing = outputs, True
        self.collecting, self.releasing = self.slow_rpdos, release
        if not (self.slow_rpdos or self.slow_sync):
            self.leave(now)

    def give_up(self, why: str) -> None:
        if self.collecting and not self.releasing:
            self.committing = self.collecting = False
            self.commit_failed = why

    @property
    def leaving(self) -> int:
        return (self.outputs ^ self._target) & ~self.partly if self.committing and not self.collecting else 0

    def question(self, board: int, now: float) -> None:
        self.questions.append((board, now))
        self._asked.add(board)

    def questioning(self, board: int) -> bool:
        return board in self._asked

    def probe_silent(self, now: float) -> None:
        pass

    @property
    def ready(self) -> bool:
        return self.known == self.all

    @property
    def outputs_known(self) -> bool:
        return self.ready and not self.committing

    @property
    def ends(self) -> int:
        self._break("measured")
        return self.inputs

    @property
    def inputs_known(self) -> int:
        return (1 << len(self._wiring.input_lines)) - 1 if self.known else 0

    def unanswered(self, lock: Interlock) -> str | None:
        return self.silent.get(lock.name)

    def fail(self, fault: ArmFault, lost: int = 0) -> None:
        self._faults.append(fault)
        self.known &= ~lost

    def drain_faults(self) -> list[ArmFault]:
        faults, self._faults = self._faults, []
        return faults

    def drain_switched(self) -> list[tuple[int, float]]:
        switched, self._switched = self._switched, []
        return switched

    def drain_missed(self) -> int:
        missed, self.missed = self.missed, 0
        self.unread &= ~missed
        return missed

    def warnings(self) -> tuple[ArmFault, ...]:
        return self.limits

    def status(self) -> MasterStatus:
        return MasterStatus((), ())

    def _break(self, verb: str) -> None:
        if verb in self.broken:
            raise RuntimeError(f"{verb} is broken")
