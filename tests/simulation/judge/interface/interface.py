"""The judge of what clients see: takes plain facts in the order in which they happen, and judges each one."""

from __future__ import annotations

import math
from collections.abc import Callable

import msgspec

from hyperbit.controller.program import (
    Accepted,
    Acknowledge,
    Begun,
    Declined,
    Diagnostics,
    Ended,
    Program,
    Question,
    Replaced,
    Replacement,
    Setpoint,
    Settled,
    Snapshot,
    Welcome,
    unpack,
)
from tests.simulation.judge.interface.account import InterfaceAccount
from tests.simulation.judge.interface.asked import cubes_of, lined, places_of
from tests.simulation.judge.interface.diagnostics import JudgedDiagnostics
from tests.simulation.judge.interface.facts import Ran, Request
from tests.simulation.judge.interface.gateway import Gateway
from tests.simulation.judge.interface.journal import Journal
from tests.simulation.judge.interface.link import Link
from tests.simulation.judge.interface.mailboxes import Mailboxes
from tests.simulation.judge.interface.messages import body_of, well_formed
from tests.simulation.judge.interface.modules import JudgedModules
from tests.simulation.judge.interface.motion import Motion
from tests.simulation.judge.interface.offers import Offers
from tests.simulation.judge.interface.progress import Progress
from tests.simulation.judge.interface.requests import Requests
from tests.simulation.judge.interface.results import Results, unanswered
from tests.simulation.judge.interface.searches import Searches
from tests.simulation.judge.interface.states import States
from tests.simulation.judge.interface.streams import Streams
from tests.simulation.judge.interface.tasks import Search
from tests.simulation.judge.interface.warnings import JudgedWarnings
from tests.simulation.judge.verdict import require

TICK = 0.02  # [s] between two looks for what does not come
MOST_PROGRAMS = 300  # that are remembered


class InterfaceJudge:
    """Judges one planner's side. The world calls the methods below as things happen.

    Args:
        wall: returns the UNIX time [s].
        driven: returns the states to which the boards drive the actuators.
    """

    def __init__(
        self, modules: JudgedModules, wall: Callable[[], float], driven: Callable[[], int], clear: Callable[[], bool]
    ) -> None:
        self.account = InterfaceAccount(modules, wall, driven, clear)
        progress = Progress(self.account)
        self.requests, self.results = Requests(self.account), Results(self.account, progress)
        self.states, self.motion = States(self.account, progress), Motion(self.account)
        self.searches, self.journal = Searches(self.account), Journal(self.account)
        self.link = Link(self.account)
        self.mailboxes = {key: Mailboxes(self.account, key) for key in ("setpoint", "measured_tip")}
        self.offers, self.gateway = Offers(self.account), Gateway(self.account)
        self.warnings, self.streams = JudgedWarnings(self.account), Streams(self.account)
        self.diagnostics = JudgedDiagnostics(self.account, self.warnings)
        self.requests.barred = self.motion.bars
        self._parts = (
            *(self.requests, self.states, self.searches, self.journal, self.diagnostics, self.streams),
            *(self.gateway, self.link, *self.mailboxes.values()),
        )
        self._asked: Program | None = None
        self._running: Ran | None = None
        self._replacing: Replacement | None = None  # the last one that the executor took
        self._met = 0  # instance of the executor that the planner is connected to
        self._ticked = 0.0
        self._epoch = -1  # that the executor told last

    def at(self, now: float) -> None:
        """Sets the time of the next facts [s], and looks for what does not come."""
        self.account.now = now
        if now >= self._ticked + TICK:
            self._ticked = now
            for part in (self.results, *self._parts):
                part.tick()

    def begins(self, process: int) -> None:
        """A process of the planner begins; 0: it has ended."""
        if not process:
            self.account.note("planner ended")
        self.account.begin(process)
        for part in (self.motion, *self._parts):
            part.begin()

    def ends_in_order(self) -> None:
        """The process has ended in order: everybody has an answer."""
        left = [str(request) for request in unanswered(self.account)]
        require(not left, f"the process has ended without the answers to {left}")

    def task(self, search: Search) -> None:
        self.searches.begins(search)
        if search.kind == "follow":
            self.streams.searches(search.tolerance)

    def quits(self) -> None:
        self.account.quits = True
        self.account.note("quit")

    def arrives(self, sent: object, key: str) -> Request:
        a = self.account
        a.numbers += 1
        fields = sent.client, key, sent.name, sent.query, sent.payload, sent.attachment  # type: ignore[attr-defined]
        body = body_of(sent.payload)  # type: ignore[attr-defined]
        request = Request(a.numbers, a.process, *fields, body, sent.at, a.now, a.awake)  # type: ignore[attr-defined]
        request.among = a.cubes
        if key in self.mailboxes:
            self.mailboxes[key].arrives(request)
        if key == "setpoint":
            a.setpoints += 1
            a.note("setpoint")
            self.streams.arrives(request.payload)
        elif key == "measured_tip":
            self.streams.tip_arrives(request)
        else:
            if key == "obstacles" and well_formed(request, a.modules):
                request.cubes, request.shown = cubes_of(request), a.shown_obstacles
            if key == "reset":
                self.motion.resets()
            self.gateway.arrives(request)
            self.requests.arrives(request)
        return request

    def takes_setpoint(self, payload: bytes, sender: str, at: float, now: float) -> None:
        """The planner's core takes a set-point that has arrived at a time [s]; malformed and late ones do not count."""
        first = self.mailboxes["setpoint"].taken(payload, sender, at)
        if self.streams.setpoint(payload, at, sender, now):
            self.motion.setpoint(sender, first)

    def replies(self, request: object, data: bytes) -> None:
        assert isinstance(request, Request)
        answer = msgspec.json.decode(data)
        self.requests.answers(request, answer)
        self.gateway.answers(request, answer)
        if request.key == "arm" and "accepted" not in answer:
            self.gateway.description(request, answer)
        if request.key in ("goal", "jog") and answer["accepted"] is False and request.original is None:
            self.journal.refused(answer)

    def publishes(self, key: str, data: bytes) -> None:
        payload = msgspec.json.decode(data)
        match key:
            case "state":
                self.states.state(payload)
                self.warnings.state(payload)
                self.journal.state(payload)
                self.gateway.state(payload)
            case "@request":
                self.gateway.note(payload)
            case "diagnostics":
                self.diagnostics.tasks = self.searches.count()
                self.diagnostics.diagnostics(payload)
                self.streams.diagnostics(payload)
            case "feedback":
                self.results.feedback(payload)
            case "result":
                self.results.result(payload)
                if payload["status"] != "refused":
                    self.journal.result(payload)

    def executor_begins(self, instance: int) -> None:
        self.account.instance = instance
        self.motion.executor_begins()
        self._asked = self._running = None

    def executor_ends(self) -> None:
        self.account.note("executor ended")
        self.account.instance = 0
        self._asked = self._running = None

    def executor_gets(self, message: object) -> None:
        a = self.account
        match message:
            case Program():
                self._asked = message
                a.note("offered")
                self.offers.gets(message)
                self.searches.offered(message.name.partition(" ")[2])
            case Replacement() if (ran := self._of(message.program)) is not None:
                ran.replaced, self._replacing = True, message
                if ran.places and ran.request is not None:
                    ran.places |= places_of((*ran.program.stages[:1], *message.stages), ran.request)
            case Setpoint():
                self.motion.follows(message)
                self.streams.follows(message)
            case Acknowledge():
                self.motion.acknowledges(message)

    def executor_tells(self, message: object) -> None:
        a = self.account
        match message:
            case Snapshot():
                if message.epoch != self._epoch:
                    self._epoch = message.epoch
                    a.note("epoch")
            case Accepted() if self._asked is not None:
                self._accept(self._asked, message)
            case Replaced(accepted=True) if (ran := self._of(message.program)) is not None:
                new = self._replacing
                if new is not None and new.stages:  # without stages, the others follow
                    ran.marks = [*ran.marks[: new.first], *(stage.mark for stage in new.stages)]
            case Declined():
                a.note(f"declined {message.refused.reason.value}")
            case Begun() if (ran := self._of(message.program)) is not None:
                ran.stage = message.stage
            case Ended() if (ran := self._of(message.program)) is not None:
                if ran.ended is None:
                    ran.ended, ran.ended_at = message, a.now
                if self._running is ran:
                    self._running = None

    def _accept(self, program: Program, accepted: Accepted) -> None:
        a = self.account
        kind, _, goal = program.name.partition(" ")
        snapshot = a.snapshot
        exact = snapshot is not None and not snapshot.moving and snapshot.measured == snapshot.outputs and a.clear()
        states, locked = unpack(program.start), 0 if snapshot is None else unpack(snapshot.locked)
        if snapshot is not None:
            states = states & ~locked | unpack(snapshot.measured) & locked
        cubes = tuple(sorted({*a.cubes, *a.known_cubes(None)}))
        ran = Ran(a.instance, a.process, program, goal, kind == "jog", a.now, a.awake, states, locked, cubes, exact)
        a.programs[ran.key] = self._running = ran
        asked = next((r for r in reversed(a.requests) if r.key == "goal" and r.goal == goal), None)
        if asked is not None and lined(asked):
            ran.places = places_of(program.stages, asked)
        self.requests.accepted(ran)
        ran.accepted_awake = a.awake
        ran.marks = [stage.mark for stage in program.stages]
        for key in list(a.programs)[:-MOST_PROGRAMS]:
            del a.programs[key]

    def _of(self, program: int) -> Ran | None:
        return self.account.programs.get((self.account.instance, program))

    def _heard_of(self, program: int) -> Ran | None:
        """Returns a program of the executor that the planner has met last; it may have ended since."""
        return self.account.programs.get((self._met, program))

    def switches(self, mask: int) -> None:
        self.account.note("switched")
        if self._running is not None:
            self._running.switches += mask.bit_count()
        if mask:
            self.motion.switches(mask, self._running)

    def hears(self, message: object) -> None:
        a = self.account
        self.link.hears(isinstance(message, Welcome))
        match message:
            case Snapshot():
                self._compare(a.snapshot, message)
                a.hears(message)
            case Question():
                self.link.asks(message)
            case Diagnostics():
                self.diagnostics.hears(message)
            case Welcome():
                self._met, a.alone_since, a.met = a.instance, math.inf, True
                if a.counts_at_start is None:
                    a.counts_at_start = sum(map(max, a.ledger_counts, message.counts or a.ledger_counts))
            case Begun() if (ran := self._heard_of(message.program)) is not None:
                marks = ran.marks[message.stage :]
                ran.begun_marks.append((next((m for m in marks if m >= 0), len(marks)), a.awake))
            case Settled() if (ran := self._heard_of(message.program)) is not None:
                ran.settled[message.mark] = message, a.awake
            case Ended() if (ran := self._heard_of(message.program)) is not None:
                ran.seen, ran.heard_by = ran.seen or a.snapshot is not None, a.process
                ran.heard_at, ran.heard_awake = min(ran.heard_at, a.now), min(ran.heard_awake, a.awake)

    def _compare(self, before: Snapshot | None, snapshot: Snapshot) -> None:
        a = self.account
        if before is None or before.epoch != snapshot.epoch:
            a.note("epoch")
        if before is None or (before.outputs, before.moving) != (snapshot.outputs, snapshot.moving):
            a.note("moved")
        if before is None or (before.measured, before.known) != (snapshot.measured, snapshot.known):
            a.note("measured")
        if before is None or before.locks != snapshot.locks:
            a.note("locks")
        if snapshot.mode == "fault":
            a.note("fault")
        a.needs_tables(snapshot)

    def disconnected(self) -> None:
        self.account.loses()
        self.diagnostics.hears(None)
        self.link.ends()

    def tables_built(self, locked: bytes | None) -> None:
        """A worker has answered with tables for locked states; None: it has failed."""
        self.account.takes_tables(locked)

    def recorded(self, goal: str, status: str) -> None:
        for ran in self.account.ran(goal):
            if ran.results and ran.results[0]["status"] == status:
                ran.recorded_at = min(ran.recorded_at, self.account.now)

    def scene_begun(self) -> None:
        self.account.scenes += 1
        self.account.note("cubes")

    def scene_built(self, right: bool) -> None:
        """A worker has built a scene, or has failed."""
        self.account.scenes -= 1
        self.account.note("scene")
        self.account.note("cubes" if right else "task failed")


__all__ = ["InterfaceJudge", "cubes_of"]
