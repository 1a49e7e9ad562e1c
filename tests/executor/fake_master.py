"""A CANopen master without buses, for tests of what stands on it."""

from __future__ import annotations

from typing import Any

from drivers.canopen.faults import Busy, Fault
from drivers.canopen.status import Status
from drivers.canopen.wiring import Timing, Wiring


class FakeMaster:
    """A master without buses: what is committed leaves with the next event, and is measured a travel time later."""

    def __init__(self, wiring: Wiring, timing: Timing, send: Any) -> None:
        nodes = sorted({(c.bus, c.node) for c in wiring.channels})
        self.board_of = tuple(nodes.index((c.bus, c.node)) for c in wiring.channels)
        self.sensed = sum(1 << k for k, c in enumerate(wiring.channels) if c.input is not None)
        self.outputs = self.inputs = 0
        self.all, self._travel = (1 << len(wiring.channels)) - 1, timing.travel_time
        self.up = self.answers = True
        self.back = False
        self.known = 0
        self.booting = self.committing = False
        self.boots = 0
        self.boot_faults: list[Fault] = []
        self.commit_failed: str | None = None
        self.commits: list[tuple[float, int]] = []
        self.questions: list[tuple[int, float]] = []
        self.busy = self.slow_sync = False
        self.stuck = self.partly = 0  # masks: that never arrive, that a SYNC does not switch
        self.halt: Fault | None = None
        self.broken: set[str] = set()
        self.ticks: list[float] = []
        self.left: list[tuple[float, int]] = []  # when which actuators were switched
        self._target = 0
        self._arrivals: list[tuple[float, int, int]] = []
        self._faults: list[Fault] = []
        self._switched: list[tuple[int, float]] = []
        self._asked: set[int] = set()

    def take(self, event: Any, now: float) -> None:
        self._break("take")

    def tick(self, now: float) -> None:
        self.ticks.append(now)
        self._break("tick")
        if self.booting:
            self.booting = False
            self.known = 0 if self.boot_faults else self.all
        for due, mask, states in list(self._arrivals):
            if now >= due - 1e-9:
                moved = mask & ~self.stuck
                self.inputs = (self.inputs & ~moved) | (states & moved)
                self._arrivals.remove((due, mask, states))
        if self.answers:
            self._asked.clear()
        if not self.slow_sync:
            self.leave(now)

    def leave(self, now: float) -> None:
        """Lets the SYNC leave."""
        if self.committing:
            self.committing = False
            mask = (self.outputs ^ self._target) & ~self.partly
            self.outputs ^= mask
            self.commit_failed = "one bus failed" if self.partly else None
            self._arrivals.append((now + 0.8 * self._travel, mask, self.outputs))
            self._switched.append((mask, now))
            if mask:
                self.left.append((now, mask))

    def halted(self, now: float) -> Fault | None:
        halt, self.halt = self.halt, None
        return halt

    def boot(self, now: float) -> None:
        self._break("boot")
        self.boots += 1
        self.booting, self.committing = True, False
        self._faults.clear()

    def commit(self, states: int, now: float) -> None:
        self._break("commit")
        if self.busy or self.committing:
            raise Busy("the queue is full")
        self.commits.append((now, states))
        self._target, self.committing = states, True
        if not self.slow_sync:
            self.leave(now)

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
    def measured(self) -> int:
        self._break("measured")
        return ((self.inputs & self.sensed) | (self.outputs & ~self.sensed)) & self.known

    def fail(self, fault: Fault, lost: int = 0) -> None:
        self._faults.append(fault)
        self.known &= ~lost

    def take_faults(self) -> list[Fault]:
        faults, self._faults = self._faults, []
        return faults

    def take_switched(self) -> list[tuple[int, float]]:
        switched, self._switched = self._switched, []
        return switched

    def warnings(self) -> tuple[Fault, ...]:
        return ()

    def status(self) -> Status:
        return Status((), ())

    def _break(self, verb: str) -> None:
        if verb in self.broken:
            raise RuntimeError(f"{verb} is broken")
