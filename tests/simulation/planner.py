"""A planner with random requests, which is slow, hangs and dies; and an operator who halts the arm."""

from __future__ import annotations

from functools import partial
from random import Random

from msgspec.structs import replace

from hyperbit.controller.executor.arm.arm import ExecutedArm
from hyperbit.controller.executor.core.events import ClientId, FromClient
from hyperbit.controller.program import (
    ALIVE_EVERY,
    Accepted,
    Acknowledge,
    Alive,
    Answer,
    Begun,
    Cancel,
    Clearance,
    Counts,
    Declined,
    Down,
    Ended,
    Goodbye,
    Lock,
    PlayFault,
    Question,
    Replaced,
    Reset,
    Setpoint,
    Snapshot,
    Stop,
    Up,
    Welcome,
    unpack,
)
from tests.simulation.agenda import Agenda
from tests.simulation.executor.connection import Connection
from tests.simulation.executor.process import ExecutorProcess
from tests.simulation.executor.programs import Author, Drawn, commissioning

ACTS: dict[str, float] = {"program": 30, "bad program": 8, "bad set-point": 6, "bad replacement": 5, "replacement": 12}
ACTS |= {"park": 6, "resume": 12, "set-point": 20, "wait": 40, "cancel": 3, "cancel program": 2, "reset": 1, "lock": 4}
ACTS |= {"counts": 1, "stray answer": 1, "acknowledge": 8, "operator": 1, "fault to play": 1, "commission": 1.5}
CALM_PATIENCE = {"": 0.01, "clear": 0.03, "touched": 0.03, "silent": 1e6, "stream": 0.12}  # [s] until an answer
INTERRUPTS = 2 * 10**9  # number of the requests that arrive at once
PLAYED = 10**9  # number of the requests of faults to play, which are answered when they were played
BOARDS = ("can0/1", "can1/2")


class ScriptedPlanner:
    """The planner's process and its connection to the executor.

    Attributes:
        commissions: it connects as a commissioner, in the planner's place.
        calm: it sends only the resets that are needed, and unlocks actuators.
        unlocks: whether it unlocks actuators while it is calm.
        patient: while it is calm, it waits for faults to clear by themselves.
        snapshot: the latest snapshot; None before the first of a connection.
        results: results that it has not acknowledged.
        way: how it answers questions while it is calm: "clear", "touched", "silent" or "stream"; "": it answers soon.
        last_answer: the last answer to a request with a number; None before it comes.
    """

    def __init__(self, arm: ExecutedArm, agenda: Agenda, random: Random, executor: ExecutorProcess) -> None:
        self.calm, self.patient, self.unlocks, self.commissions = False, False, True, False
        self.snapshot: Snapshot | None = None
        self.results: list[int] = []
        self._arm, self._agenda, self._random, self._executor = arm, agenda, random, executor
        self._author = Author(arm, random)
        self.connection = Connection(arm.name, agenda, random, executor, self._hear, lambda: self._awake_at)
        self._awake_at = 0.0
        self._number = self._request = 0
        self._wanted = -1  # the program that it sent while it was calm
        self._drawn: Drawn | None = None
        self._answered = 0
        self.last_answer: Answer | None = None
        self.way = ""
        agenda.after(0.0, self._live)
        agenda.after(0.0, self._act)

    def stall(self, seconds: float) -> None:
        """Makes it hang for a time [s], perhaps after it has planned a request and before it sends it."""
        self._awake_at = max(self._awake_at, self._agenda.now + seconds)
        client, snapshot, wakes = self.connection.client, self.snapshot, self._awake_at
        if client is None or snapshot is None or self._random.random() < 0.3:
            return
        self._number += 1
        drawn, request = None, self._author.setpoint(snapshot, self._number, wakes)
        if self._random.random() < 0.6:
            drawn = self._author.program(snapshot, self._number, wakes)

        def send() -> None:
            if client == self.connection.client and self.awake:
                self._drawn = drawn
                self.connection.send(request if drawn is None else drawn.program)

        self._agenda.at(wakes, send)

    @property
    def awake(self) -> bool:
        return self._agenda.now >= self._awake_at

    def be_calm(self, calm: bool) -> None:
        self.calm, self._wanted = calm, -1
        if calm and self.commissions:
            self.commission(False)

    def commission(self, begin: bool) -> None:
        """Connects again as a commissioner, or as a planner."""
        self.commissions = begin
        self.die()

    def die(self) -> None:
        """Ends the process; the next one starts with the next period."""
        self.connection.close()
        self.cut_off()

    def cut_off(self) -> None:
        self.connection.client = self.snapshot = self._drawn = None
        self.results.clear()

    def _hear(self, message: Up) -> None:
        match message:
            case Welcome():
                self._number = max(self._number, message.program)
            case Goodbye():
                self.cut_off()
            case Snapshot():
                self.snapshot = message
            case Ended():
                self.results.append(message.result)
            case Declined() if self._drawn is not None and self._drawn.program.program == message.program:
                self._drawn = None
            case Accepted() if self._drawn is not None and self._drawn.program.program == message.program:
                self._drawn.begin = message.begin
            case Begun() if self._drawn is not None and self._drawn.program.program == message.program:
                self._drawn.taken = message.stage
            case Replaced() if self._drawn is not None and self._drawn.program.program == message.program:
                self._drawn.answered(message.accepted)
            case Question():
                self._answer(message)
            case Answer() if 0 < message.request < PLAYED:
                assert self._answered < message.request <= self._request, "answers come once, in order"
                self._answered, self.last_answer = message.request, message

    def _answer(self, question: Question) -> None:
        touched = "the disc" if self._random.random() < 0.1 and not self.calm else None
        if self.calm and self.way:
            touched = "the disc" if self.way == "touched" else None
        patience = CALM_PATIENCE[self.way] if self.calm else self._random.choice([0.0, 0.01, 0.1, 2.0, 1e6])
        client = self.connection.client

        def answer() -> None:
            if client is not None and client == self.connection.client and self.awake:
                self.connection.send(Clearance(question.question, touched))

        if patience < 1e6:
            self._agenda.after(patience, answer)

    def _live(self) -> None:
        if self.awake:
            if self.connection.client is None:
                self._answered = self._request
                self.connection.open("commissioner" if self.commissions else "planner")
            elif self.connection.client is not None:
                self.connection.send(Alive())
        self._agenda.after(ALIVE_EVERY * self._random.uniform(0.9, 1.0), self._live)

    def _act(self) -> None:
        if self.connection.client is not None and self.snapshot is not None and self.awake:
            if self.calm:
                self._calm_act(self.snapshot)
            elif self.commissions:
                self._number += 1
                act, message = commissioning(self._author, self._random, self.snapshot, self._number, self._agenda.now)
                self._carry_out(act, message)
            else:
                self._perform(self.snapshot)
        self._agenda.after(0.2 if self.calm else self._random.expovariate(20.0), self._act)

    def _calm_act(self, snapshot: Snapshot) -> None:
        self._acknowledge()
        if snapshot.mode in ("fault", "stopped"):
            if snapshot.mode == "stopped" or not self.patient:
                self._reset(snapshot)
        elif snapshot.mode == "executing" and snapshot.program != self._wanted:
            self.connection.send(Cancel(self._next(), None, "quiet is wanted"))
        elif snapshot.mode == "ready" and self.unlocks:
            free = [k for k in range(len(self._arm.actuators)) if unpack(snapshot.locked) & ~self._arm.locked & 1 << k]
            for k in free[:1]:
                self.connection.send(Lock(self._next(), k, -1))

    def ask_for_motion(self, strict: bool | None = None) -> int:
        """Sends one correct program; returns its number. `strict`: None to draw it."""
        assert self.snapshot is not None
        self._number += 1
        self._drawn = self._author.program(self.snapshot, self._number, self._agenda.now)
        if strict is not None:
            self._drawn.program = replace(self._drawn.program, strict=strict)
        self.connection.send(self._drawn.program)
        self._wanted = self._number
        return self._number

    def ask_to_switch(self, actuator: int, times: int = 1, pause: float = 0.0, strict: bool = False) -> None:
        """Sends a program that switches one actuator, perhaps to and fro with pauses [s]."""
        assert self.snapshot is not None
        self._number += 1
        self._drawn = self._author.switch(self.snapshot, self._number, actuator, times, pause, strict)
        self.connection.send(self._drawn.program)
        self._wanted = self._number

    def interrupt(self) -> None:
        """Sends a stop or a cancel that arrives at once."""
        client = self.connection.client
        if client is not None:
            message = Stop(INTERRUPTS) if self._random.random() < 0.5 else Cancel(INTERRUPTS, None, "interrupted")
            self._executor.hear(client, FromClient(client, message))

    def cancel_now(self) -> None:
        """Sends a cancel that arrives at once."""
        if (client := self.connection.client) is not None:
            self._executor.hear(client, FromClient(client, Cancel(INTERRUPTS, None, "interrupted")))

    def halt(self) -> None:
        """Makes an operator stop the arm, if an executor runs."""
        if self.connection.client is not None:
            self.connection.halt()

    def ask_strictly(self, actuator: int, way: str) -> None:
        """Asks for a strict stage that switches one actuator, by a program or by set-points; see `way`."""
        if self.snapshot is None or self.connection.client is None:
            return
        self.way, self._number = way, self._number + 1
        if way != "stream":
            self._drawn = self._author.switch(self.snapshot, self._number, actuator, 1, 0.0, strict=True)
            self.connection.send(self._drawn.program)
            self._wanted = self._number
            return
        first = self._author.strict_setpoint(self.snapshot, self._number, self._agenda.now, actuator)
        for k in range(4):
            self._agenda.after(k * 0.04, partial(self._follow, first, self.connection.client, k))

    def _follow(self, message: Setpoint, client: ClientId, k: int) -> None:
        if self.connection.client == client:
            self.connection.send(replace(message, until=message.until + k * 0.04, reason=f"following {k}"))

    def _reset(self, snapshot: Snapshot) -> None:
        """Sends a reset, seldom one that was asked for in an earlier epoch."""
        earlier = 1 if snapshot.epoch > 0 and self._random.random() < 0.15 else 0
        self.connection.send(Reset(self._next(), snapshot.epoch - earlier))

    def ask_to_lock(self, actuator: int, state: int) -> None:
        """Locks an actuator; it stays locked while `unlocks` is False."""
        self.unlocks = False
        self.connection.send(Lock(self._next(), actuator, state))

    def ask_to_reset(self) -> None:
        assert self.snapshot is not None
        self.last_answer = None
        self.connection.send(Reset(self._next(), self.snapshot.epoch))

    def _perform(self, snapshot: Snapshot) -> None:
        random, now = self._random, self._agenda.now
        if snapshot.mode in ("fault", "stopped") and random.random() < 0.2:
            self._reset(snapshot)
            return
        match random.choices(list(ACTS), list(ACTS.values()))[0]:
            case "program":
                self.ask_for_motion()
            case "bad program":
                self._number += 1
                good = self._author.program(snapshot, self._number, now)
                self.connection.send(self._author.spoiled(good.program, snapshot, now))
            case "bad set-point":
                good_one = self._author.setpoint(snapshot, self._number + 1, now)
                self.connection.send(self._author.spoiled_setpoint(good_one, snapshot, now))
                self._number += 1
            case "bad replacement" if self._drawn is not None and self._drawn.sent is None:
                replacement = self._author.replacement(self._drawn, unpack(snapshot.locked))
                self._drawn.sent = self._author.spoiled_replacement(replacement)
                self.connection.send(self._drawn.sent)
                if self._drawn.sent.program != self._drawn.program.program:
                    self._drawn.sent = None  # the answer names another program
            case "replacement" if self._drawn is not None and self._drawn.sent is None:
                self.connection.send(self._author.replacement(self._drawn, unpack(snapshot.locked)))
            case "park" if self._drawn is not None and self._drawn.sent is None:
                self.connection.send(self._author.parking(self._drawn))
            case "resume" if self._drawn is not None and self._drawn.sent is None and self._drawn.cut:
                self.connection.send(self._author.resumption(self._drawn, now))
            case "set-point":
                self._number += random.random() < 0.5
                self.connection.send(self._author.setpoint(snapshot, self._number, now))
            case "cancel":
                self.connection.send(Cancel(self._next(), None, "canceled by a client"))
                if random.random() < 0.4:  # while actuators still travel
                    locked = random.randrange(len(self._arm.actuators))
                    self.connection.send(Lock(self._next(), locked, random.randint(0, 1)))
            case "cancel program":
                number = random.choice([max(0, snapshot.program), self._number, 10**9])
                self.connection.send(Cancel(0, number, "off its path"))
            case "reset":
                self._reset(snapshot)
            case "lock":
                actuator = random.randrange(len(self._arm.actuators) + 1)
                self.connection.send(Lock(self._next(), actuator, random.choice([-1, 0, 1])))
            case "counts":
                self.connection.send(Counts(self._ledger()))
            case "stray answer":
                self.connection.send(Clearance(random.randint(0, 10), random.choice([None, "the box"])))
            case "fault to play":
                self.connection.send(PlayFault(PLAYED, f"silence {random.choice(BOARDS)}"))
            case "acknowledge":
                self._acknowledge()
            case "operator" if random.random() < 0.5:
                self.connection.halt()
            case "commission":
                self.commission(True)

    def _carry_out(self, act: str, message: Down | None) -> None:
        """Does what a commissioner does."""
        match act:
            case "acknowledge":
                self._acknowledge()
            case "operator":
                self.connection.halt()
            case "planner":
                self.commission(False)
            case _ if message is not None:
                self.connection.send(message)

    def _ledger(self) -> tuple[int, ...]:
        """Returns counts of the ledger: lower ones, some that are greater than the executor's, or too few."""
        random, count = self._random, len(self._arm.actuators)
        few = random.randint(0, count)
        return random.choice([(0,) * few, tuple(random.randint(0, 100) for _ in range(count)), (10**6,) * few])

    def _acknowledge(self) -> None:
        for result in self.results:
            self.connection.send(Acknowledge(result))
        self.results.clear()

    def _next(self) -> int:
        self._request += 1
        return self._request
