"""An executor on boards that live in memory, on a clock that the test sets, with a planner that the test plays."""

from __future__ import annotations

import logging
from collections.abc import Iterable
from typing import Any, TypeVar

from controller.executor.arm import ExecutedArm
from controller.executor.core import PERIOD, Executor
from controller.executor.events import Client, ClientGone, FromClient, Log, Notify, Tick, ToClient
from controller.executor.switch_journal import MemoryJournal
from controller.program import Alive, Diagnostics, Ended, Hello, Program, Setpoint, Settled, Snapshot, Stage, pack
from drivers.canopen.events import Ignored
from drivers.canopen.faults import Busy, Fault
from drivers.canopen.status import Status
from drivers.canopen.wiring import BusSettings, Channel, Timing, Wiring

SIZE = 6
TRAVEL, MARGIN = 0.05, 0.03
PLANNER, OTHER, OPERATOR = Client(1, 4001), Client(2, 4002), Client(3, 4003)
LABELS = tuple(f"{module}.{name}" for module in (1, 2) for name in ("left", "diagonal", "right"))
LOST = Fault("board-lost", "can0/1", "board can0/1: no heartbeat")
CAN = Ignored("can0", 100)  # an event of a bus that changes nothing by itself

T = TypeVar("T")


def small_arm(sensed: int = 0b111111, **fields: Any) -> ExecutedArm:
    """An arm of two boards with three actuators each."""
    channels = tuple(
        Channel(label, "can0", 1 + k // 3, k % 3, k % 3 if sensed >> k & 1 else None) for k, label in enumerate(LABELS)
    )
    wiring = Wiring((BusSettings("can0", "virtual", "can0"),), channels)
    timing = Timing(travel_time=TRAVEL, settle_margin=MARGIN)
    return ExecutedArm("small", LABELS, wiring, timing, digest="d" * 64, **fields)


class FakeMaster:
    """A master without buses: what is committed leaves with the next event, and is measured a travel time later."""

    def __init__(self, wiring: Wiring, timing: Timing, send: Any) -> None:
        nodes = sorted({(c.bus, c.node) for c in wiring.channels})
        self.board_of = tuple(nodes.index((c.bus, c.node)) for c in wiring.channels)
        self.sensed = sum(1 << k for k, c in enumerate(wiring.channels) if c.input is not None)
        self.outputs = self.inputs = 0
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
            self.known = 0 if self.boot_faults else (1 << SIZE) - 1
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
            self._arrivals.append((now + 0.8 * TRAVEL, mask, self.outputs))
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
        return self.known == (1 << SIZE) - 1

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


class Rig:
    """An executor and all it says; `go` lets time pass, in which the planner is alive."""

    def __init__(self, **fields: Any) -> None:
        self.now = 1000.0
        self.arm = small_arm(**fields)
        self.journal = MemoryJournal(SIZE)
        self.core = Executor(self.arm, self.journal, instance=7, watchdog=0.4, build_master=FakeMaster)
        self.master: FakeMaster = self.core._master
        self.heard: list[tuple[Client, Any]] = []
        self.notified: list[str] = []
        self.logged: list[tuple[int, str]] = []
        self.alive = False
        self._programs = 0

    def do(self, event: Any) -> None:
        for action in self.core.step(event, self.now):
            match action:
                case ToClient():
                    self.heard.append((action.client, action.message))
                case Notify():
                    self.notified.append(action.text)
                case Log():
                    self.logged.append((action.level, action.text))

    def send(self, message: Any, client: Client = PLANNER) -> None:
        self.do(FromClient(client, message))

    def connect(self, client: Client = PLANNER, role: str = "planner") -> None:
        self.send(Hello(1, role, "small"), client)
        self.alive |= client == PLANNER

    def gone(self, client: Client = PLANNER) -> None:
        self.alive = False
        self.do(ClientGone(client))

    def go(self, seconds: float = PERIOD) -> None:
        for _ in range(max(round(seconds / PERIOD), 1)):
            self.now += PERIOD
            if self.alive:
                self.send(Alive())
            self.do(Tick())

    def program(self, *states: int, step: float = 0.2, final: bool = True, **fields: Any) -> Program:
        """A program whose every stage has a mark that settles a lead after it may begin."""
        self._programs += 1
        stages = tuple(
            Stage(pack(bits, SIZE), at=step * k, mark=k, settled=step * k + TRAVEL + PERIOD)
            for k, bits in enumerate(states)
        )
        given = {"number": self._programs, "epoch": self.snapshot.epoch, "start": self.master.outputs, "begin": 0.0}
        given |= {"strict": False, "name": f"goal {self._programs}", "context": b"", "stages": stages} | fields
        return Program(
            program=given["number"],
            epoch=given["epoch"],
            start=pack(given["start"], SIZE),
            begin=given["begin"],
            stages=given["stages"],
            final=final,
            strict=given["strict"],
            name=given["name"],
            context=given["context"],
        )

    def run(self, *states: int, **fields: Any) -> Program:
        program = self.program(*states, **fields)
        self.send(program)
        return program

    def follow(self, stream: int, *stages: int, lasting: float = 0.25, **fields: Any) -> None:
        given = {"epoch": self.snapshot.epoch, "start": self.master.outputs, "strict": False} | fields
        self.send(
            Setpoint(
                stream=stream,
                epoch=given["epoch"],
                start=pack(given["start"], SIZE),
                stages=tuple(pack(bits, SIZE) for bits in stages),
                until=self.now + lasting,
                strict=given["strict"],
                reason="following a setpoint",
            )
        )

    def of(self, kind: type[T], client: Client = PLANNER) -> list[T]:
        return [message for receiver, message in self.heard if isinstance(message, kind) and receiver == client]

    def last(self, kind: type[T], client: Client = PLANNER) -> T:
        return self.of(kind, client)[-1]

    @property
    def snapshot(self) -> Snapshot:
        return self.last(Snapshot)

    @property
    def diagnostics(self) -> list[Diagnostics]:
        return self.of(Diagnostics)

    @property
    def results(self) -> list[tuple[int, str]]:
        return [(ended.program, ended.status) for ended in self.of(Ended)]

    @property
    def marks(self) -> list[int]:
        return [settled.mark for settled in self.of(Settled)]

    @property
    def switched(self) -> list[int]:
        """States of all commits."""
        return [states for _, states in self.master.commits]

    @property
    def mode(self) -> str:
        return self.core.modes.mode

    @property
    def reason(self) -> str:
        return self.core.modes.reason

    def errors(self) -> Iterable[str]:
        return [text for level, text in self.logged if level >= logging.ERROR]


def ready(**fields: Any) -> Rig:
    """A rig that is ready, with a planner."""
    rig = Rig(**fields)
    rig.connect()
    rig.go(3 * PERIOD)
    assert rig.mode == "ready", rig.reason
    return rig
