"""The account of the planner's side: requests and answers, programs and results, and what its process was told."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterator
from typing import TYPE_CHECKING

from hyperbit.controller.executor.core.events import ClientId, Event, FromClient
from hyperbit.controller.program import (
    Accepted,
    Begun,
    Down,
    Ended,
    Program,
    Replaced,
    Replacement,
    Settled,
    Snapshot,
    Up,
    Welcome,
    unpack,
)
from tests.simulation.statements.account import Account
from tests.simulation.statements.asked import Heard, Payload, Ran, Request, body_of, states_from
from tests.simulation.statements.statement import Witness
from tests.simulation.whole.configurations import Disc

if TYPE_CHECKING:
    from tests.simulation.whole.daemon import Daemon

REMEMBERED = 60.0  # [s] for which answered requests are kept
SETTLED = 0.02  # [s], awake, in which all snapshots are the same before a program that is surely planned from them
AWAY = 4.0  # [s], longest time until clients are connected again
PAUSE = 0.25  # [s] without a set-point, after which a stream has ended
OLDEST, AHEAD = 0.2, 0.05  # [s] of a set-point between its stamp, its arrival and the core; of stamps from the future
DECEIVED = 5.0  # [s] after the clock was set in which stamps may seem fresh
MAILBOXES = ("setpoint", "measured_tip")
SAME = 1e-6  # [s]


class Exchange(Witness):
    """What the world knows of clients, planner and executor.

    Statements see these facts by methods of these names: accepts(ran): an executor accepts a program.
    answered(request, answer), state(payload), feedback(payload), result(payload), diagnostics(payload): what clients
    get; ends(ran, payload) is the first result of a program. planner_begins(), ends_in_order(), planner_logs(text): of
    the planner's process.

    Attributes:
        process: number of the planner's present process; 0 between two.
        instance: number of the executor's process.
        requests: of the present process, and those that were answered.
        programs: accepted by executors, by instance and number.
        heard: snapshots of the present process, the newest last.
        confirmed: obstacles of the newest request that was accepted; `changed_at` is the time of the last change.
        barriers: stops and cancels that were accepted, the newest last.
        stream_began: number of the first set-point of the newest stream.
        told_at: awake time of the last state [s].
        alone_until: end of the time in which clients connect again after a standstill [s].
        reached_from: time at which clients are connected to the present process [s].
        sent: messages of each connection that the executor has not taken, the oldest first.
        fresh_at: time of the last set-point that may be followed [s].
        taken: set-points that the core has taken; `malformed` are those without a position.
    """

    def __init__(self, account: Account, daemon: Daemon) -> None:
        self.account, self._daemon = account, daemon
        self._awake = self._since = self.told_at = 0.0
        self.fresh_at = -math.inf  # also of a planner whose last messages the executor has not taken
        self.process = self.instance = self._executors = self.numbers = self.stream_began = 0
        self.sent: dict[ClientId, deque[Down]] = {}
        self.requests: list[Request] = []
        self.programs: dict[tuple[int, int], Ran] = {}
        self.barriers = deque[Request](maxlen=30)
        self.state: Payload | None = None
        self._last: dict[str, float] = {}  # time of the last event of each kind [s]
        self._streams: dict[str, float] = {}  # time of the last set-point of each sender [s]
        self._setpoints: dict[str, int] = {}  # number of the latest set-point of each sender
        self._offered: Program | None = None
        self._replacing: Replacement | None = None
        self._met = 0
        self.begins(0)

    @property
    def awake(self) -> float:
        """Time for which processes of the planner did not stand still [s]."""
        return self._awake + max(self.account.now - max(self._since, self._daemon.awake_since), 0.0)

    def stands_still(self) -> None:
        """The process will stand still until another time."""
        self._awake, self._since = self.awake, self.account.now

    def begins(self, process: int) -> None:
        """A process of the planner begins; 0: it has ended, and so have its requests and obstacles."""
        self.process, self.quits, self.began, self.state = process, False, self.awake, None
        self.alone_until, self.reached_from = 0.0, self.account.now + AWAY
        self.requests = [request for request in self.requests if request.answer is not None]
        self.heard = deque([Heard(self.awake, None)], maxlen=1_000)
        self.taken = self.malformed = 0
        self.confirmed, self._confirmed_by, self.changed_at = frozenset[Disc](), 0, self.account.now
        if process:
            self.account.see("planner_begins")
        else:
            self.note("planner")

    def stood_still(self, until: float) -> None:
        """The process stood still until a time, so long that clients must connect again."""
        self.alone_until = until + AWAY

    def note(self, kind: str, at: float | None = None) -> None:
        self._last[kind] = self.account.now if at is None else at

    def happened(self, kind: str, since: float) -> bool:
        return self._last.get(kind, -math.inf) >= since

    def disk_was_full(self, since: float) -> bool:
        return self._daemon.storage.room is not None or self.happened("disk", since)

    @property
    def hindered(self) -> bool:
        """Whether something may delay answers."""
        return self._daemon.hindered

    def erred(self, since: float) -> bool:
        """Whether a plan has ended before its goal, as it was drawn."""
        return self._daemon.mood.erred_at >= since

    @property
    def lead(self) -> float:
        """Time of one stage [s]."""
        return self._daemon.pace.lead

    @property
    def offset(self) -> tuple[float, float]:
        """Measured tips, from the computed ones."""
        return self._daemon.offset

    def wall(self) -> float:
        return self._daemon.wall()

    def recorded(self, ran: Ran) -> tuple[bool, tuple[str, int, str, float] | None]:
        """Returns whether the ledger has a program; and status, code, message and time of its result."""
        return self._daemon.storage.has(ran.instance, ran.program.program)

    # --- clients

    def arrives(self, key: str, name: str, query: bool, payload: bytes, attachment: bytes) -> Request:
        self.numbers += 1
        request = Request(self.numbers, key, name, query, body_of(payload), self.account.now, self.awake)
        request.sent = (payload, attachment) if attachment else None
        if key == "obstacles":
            self.changed_at = self.account.now
        if key not in MAILBOXES:
            self.requests.append(request)
        elif key == "setpoint" and "*" not in name:
            self._setpoints[attachment[:64].decode("ascii", "backslashreplace")] = request.number
        return request

    def replies(self, request: Request, answer: Payload) -> None:
        self.account.see("answered", request, answer)
        request.answer, request.answered_at = answer, self.account.now
        if request.key == "obstacles":
            self.changed_at = self.account.now
        if not request.accepted:
            return
        if request.key in ("stop", "cancel"):
            self.barriers.append(request)
        if request.key == "obstacles" and request.number > self._confirmed_by:
            self.confirmed, self._confirmed_by = request.discs, request.number
        if len(self.requests) > 400:
            self.requests = [r for r in self.requests if r.answer is None or r.at > self.account.now - REMEMBERED]

    def unanswered(self, *keys: str) -> list[Request]:
        return [r for r in self.requests if r.query and r.answer is None and (not keys or r.key in keys)]

    def ran(self, goal: object) -> list[Ran]:
        """Returns the programs of an id, the oldest first."""
        return [ran for ran in self.programs.values() if ran.goal == goal]

    def publishes(self, key: str, payload: Payload) -> None:
        self.account.see(key.strip("@"), payload)
        ran = self.ran_of(payload) if key == "result" and payload["status"] != "refused" else None
        if ran is not None and not ran.results and not payload.get("repeated"):
            self.account.see("ends", ran, payload)
        match key:
            case "state":
                self.state, self.told_at = payload, self.awake
            case "feedback" if (ran := self.ran_now(payload["id"])) is not None:
                ran.feedback.append(payload)
            case "result" if payload["status"] == "refused":
                puts = (r for r in self.requests if not r.query and r.answer is None and r.goal == payload["id"])
                if (put := next(puts, None)) is not None:
                    put.answer, put.answered_at = {**payload, "accepted": False}, self.account.now
            case "result" if ran is not None:
                ran.results.append(payload)
                ran.result_at = min(ran.result_at, self.account.now)
                ran.over_at = min(ran.over_at, self.awake)

    def ends_in_order(self) -> None:
        self.account.see("ends_in_order")

    def ran_of(self, payload: Payload) -> Ran | None:
        """Returns the program of a result: the oldest of its id that has ended or is lost, and has none.

        A repeated result is that of a program with the same result, if there is one.
        """
        every = self.ran(payload["id"])
        same = [ran for ran in every if {**payload, "repeated": None} in [{**r, "repeated": None} for r in ran.results]]
        if payload.get("repeated") and same:
            return same[-1]
        without = [ran for ran in every if not ran.results and not ran.given_up]
        if payload["status"] != "lost":
            without.sort(key=lambda ran: ran.ended is None)
        return without[0] if without else every[-1] if every else None

    def ran_now(self, goal: str | None) -> Ran | None:
        """Returns the program of an id that runs, as far as clients know."""
        mine = [ran for ran in self.ran(goal) if ran.process == self.process and not ran.results]
        return mine[-1] if mine else None

    @property
    def running(self) -> bool:
        """Whether a program of the present executor has not ended."""
        return any(ran.ended is None and ran.instance == self.instance for ran in self.programs.values())

    @property
    def in_force(self) -> frozenset[Disc]:
        """The obstacles that are surely in force: others may count from the arrival of their request on."""
        return self.confirmed.intersection(*(r.discs for r in self._pending()))

    @property
    def possible(self) -> frozenset[Disc]:
        """All obstacles that may be in force."""
        return self.confirmed.union(*(r.discs for r in self._pending()))

    def kept_obstacles(self, since: float) -> bool:
        """Whether the obstacles are surely the same since a time."""
        return self.changed_at <= since and not self._pending()

    def _pending(self) -> list[Request]:
        return [r for r in self.requests if r.key == "obstacles" and r.answer is None and _are_regions(r.body)]

    # --- executor

    def started(self) -> None:
        self._executors += 1
        self.instance, self._offered = self._executors, None

    def killed(self) -> None:
        self.instance, self._offered = 0, None

    def told(self, event: Event) -> None:
        match event:
            case FromClient(_, Program() as message):
                self._offered = message
            case FromClient(_, Replacement() as message):
                self._replacing = message

    def says(self, message: Up) -> None:
        match message:
            case Accepted() if (program := self._offered) is not None:
                fields = self._asked(program), self.account.now, self.awake, self._start(program), self.possible
                ran = Ran(self.instance, self.process, program, *fields, [stage.mark for stage in program.stages])
                self.account.see("accepts", ran)
                self.programs[self.instance, program.program] = ran
            case Replaced(accepted=True) if (ran := self._of(message.program)) and self._replacing:
                new, ran.replaced = self._replacing, True
                if new.stages:  # without stages, the others follow
                    ran.marks = [*ran.marks[: new.first], *(stage.mark for stage in new.stages)]
            case Ended() if (ran := self._of(message.program)) and ran.ended is None:
                ran.ended, ran.ended_at = message, self.account.now

    def _of(self, program: int) -> Ran | None:
        return self.programs.get((self.instance, program))

    def _asked(self, program: Program) -> Request | None:
        """Returns the request of a program: its last permitted begin tells the time of arrival."""
        kind, _, goal = program.name.partition(" ")
        fits = [r for r in self.requests if r.key == kind and abs(r.at + r.patience - program.until) < SAME]
        fits = [r for r in fits if r.goal in (None, goal)]
        return fits[0] if len(fits) == 1 else None

    def _start(self, program: Program) -> tuple[int, int] | None:
        """Returns from where a program was planned, and what was locked, if that is sure."""
        snapshots = list(self.lately(SETTLED))
        first = snapshots[0]
        if first is None or first.outputs != program.start:
            return None
        same = all(
            s is not None and states_from(s) == states_from(first) and s.locked == first.locked for s in snapshots
        )
        return (states_from(first), unpack(first.locked)) if same else None

    # --- the planner's process

    def takes_setpoint(self, payload: bytes, sender: str, age: float) -> None:
        """The core takes the latest set-point of a sender; a stream begins after a pause. Late ones do not count."""
        now, fits = self.account.now, b"position" in payload
        self.taken, self.malformed = self.taken + 1, self.malformed + (not fits)
        if fits and self._is_fresh(body_of(payload).get("stamp")):
            self.fresh_at = now
        if age > OLDEST or not fits:
            return
        if now - self._streams.get(sender, -math.inf) > PAUSE:
            self.stream_began = max(self.stream_began, self._setpoints.get(sender, 0))
        self._streams[sender] = now

    def _is_fresh(self, stamp: float | None) -> bool:
        """Returns whether a set-point of a stamp may be followed; a clock that was set may deceive the planner."""
        deceived = self.happened("clock", self.account.now - DECEIVED)
        return deceived or not stamp or -AHEAD < self.wall() - stamp < OLDEST + AHEAD

    def writes(self, client: ClientId, message: Down) -> None:
        """The planner's process sends a message to an executor; the socket may be full."""
        if client not in self.sent:
            self.sent = {client: deque()}
        self.sent[client].append(message)

    def hears(self, message: object) -> None:
        """A message comes to the planner's process; None: the connection ended."""
        match message:
            case Snapshot() | None:
                self.heard.append(Heard(self.awake, message))
            case Welcome():
                self._met = self.instance
            case Begun() if (ran := self._met_ran(message.program)) is not None:
                ran.mark = max(ran.mark, next((m for m in ran.marks[message.stage :] if m >= 0), -1))
            case Settled() if (ran := self._met_ran(message.program)) is not None:
                ran.told[message.mark] = message

    def _met_ran(self, program: int) -> Ran | None:
        return self.programs.get((self._met, program))

    @property
    def snapshot(self) -> Snapshot | None:
        return self.heard[-1].snapshot

    def lately(self, seconds: float) -> Iterator[Snapshot | None]:
        """Yields what held at some time in the last seconds in which the process was awake, the newest first."""
        for heard in reversed(self.heard):
            yield heard.snapshot
            if heard.awake < self.awake - seconds:
                return


def _are_regions(body: Payload) -> bool:
    return isinstance(body.get("regions"), list)
