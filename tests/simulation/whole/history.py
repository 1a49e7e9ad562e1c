"""The history of the planner's processes for the invariants: requests, answers, results."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, NamedTuple

from controller.host.process import Log
from controller.motion.decoding.goal import GoalMessage
from controller.planning.core.events import (
    Action,
    Answered,
    Event,
    FromExecutor,
    Identity,
    Key,
    LinkDown,
    Payload,
    Publish,
    PublishResult,
    Record,
    Reply,
    SentObstacles,
    Start,
    ToExecutor,
)
from controller.planning.core.tasks import Failed
from controller.program import Alive, Ended, Snapshot, Welcome, unpack
from tests.simulation.agenda import Agenda
from tests.simulation.whole.configurations import Cube, cubes_of

if TYPE_CHECKING:
    from tests.simulation.record import Record as ExecutorRecord
    from tests.simulation.whole.planner_process import PlannerProcess


def _locks(snapshot: Snapshot) -> tuple[int, int]:
    """Returns the number of the locks, and the measured states of the locked actuators, for which there are tables."""
    return snapshot.locks, unpack(snapshot.measured) & unpack(snapshot.locked)


BARS = ("cancel", "stop", "reset", "degrade")  # keys of requests that may begin a new epoch


@dataclass(eq=False)
class Asked:
    """A request.

    Attributes:
        process: number of the process that got it.
        number: in the order of all requests.
        key: of the interface.
        at: time of arrival [s].
        message: content.
        payload: of the answer; None before.
    """

    process: int
    number: int
    key: Key
    at: float
    message: Any = None
    payload: dict[str, Any] | None = None
    heard: Callable[[Asked], None] = field(default=lambda asked: None)

    def reply(self, payload: Payload) -> None:
        """Takes the answer."""
        self.payload = dict(payload)
        self.heard(self)

    @property
    def accepted(self) -> bool:
        """Whether it was carried out."""
        return self.payload is not None and bool(self.payload.get("accepted"))


class Beginning(NamedTuple):
    """The begin of a goal's program.

    Attributes:
        message: the goal.
        states: of the actuators.
        locked: mask of the locked actuators.
        cubes: all obstacles that may have been known.
    """

    message: GoalMessage
    states: int
    locked: int
    cubes: tuple[Cube, ...]


class History:
    """The history of a world's planners.

    Attributes:
        counts: of what happened.
        latest: the last request of each key.
        unwritten: numbers of processes that ended with records that were not written, because the disk was full.
        open: posted requests of the present process that are not answered.
        answered: requests that were answered in this step.
        goals: goals and jogs that were answered as accepted, by id.
        results: published results by program.
        told: results that were published in this step.
        recorded_results: programs whose results the ledger has reported as recorded.
        sent: messages for the executor in this step.
        unfounded: whether `state` told that the arm is ready or moves, without a connection to the executor.
        state: the last payload of `state`.
        cubes: obstacles of the last request that was carried out.
        barred_at: time of the last request or event that bars earlier requests [s].
        setpoint_at: time of the last set-point [s].
    """

    def __init__(self, agenda: Agenda, note: Callable[[object], None]) -> None:
        self.counts: Counter[str] = Counter()
        self.open: dict[int, Asked] = {}
        self.answered: list[Asked] = []
        self.latest: dict[Key, Asked] = {}
        self.unwritten: set[int] = set()
        self.goals: dict[str, list[Asked]] = {}
        self.by_id: dict[str, list[Asked]] = {}
        self.results: dict[Identity, PublishResult] = {}
        self.twice: list[Identity] = []
        self.strays: list[object] = []
        self.unfounded = False
        self.told: list[PublishResult] = []
        self.recorded_results: set[Identity] = set()
        self.sent: list[Any] = []
        self.state: Payload | None = None
        self.snapshot: Snapshot | None = None
        self.cubes: tuple[Cube, ...] = ()
        self.pending_cubes: list[tuple[Asked, tuple[Cube, ...]]] = []
        self.cubes_at = 0.0
        self.barred_at = self.setpoint_at = self.link_down_at = self.failed_at = self.quits_at = -math.inf
        self.epoch_at = self.mode_at = self.moved_at = self.locks_at = self.silent_at = -math.inf
        self.connected_to = 0
        self.stop: tuple[float, float, int] | None = None
        self.reset_at = -math.inf
        self.barred_before = 0
        self.running: set[str] = set()
        self.ends: dict[Identity, Ended] = {}
        self.by_result: dict[tuple[int, int], Identity] = {}
        self.bus_switches: Counter[Identity] = Counter()
        self.disturbed: set[Identity] = set()
        self.beginnings: dict[Identity, Beginning] = {}
        self._agenda, self._note, self._numbers = agenda, note, 0
        self._dirty = False

    def begin_step(self) -> None:
        """Forgets the facts of the step before."""
        if self._dirty:
            self.answered, self.told, self.sent, self._dirty = [], [], [], False

    # --- clients

    def asks(self, process: PlannerProcess, key: Key) -> Asked:
        """Returns a new request."""
        self._numbers += 1
        self.counts[f"asked {key}"] += 1
        self.latest[key] = Asked(process.number, self._numbers, key, self._agenda.now, heard=self._heard)
        return self.latest[key]

    def posted(self, asked: Asked) -> None:
        """Records a request that the loop gets."""
        self._note(("client asks", asked.number, asked.key, asked.message))
        self.open[asked.number] = asked
        if asked.key in BARS:
            self.barred_at = self._agenda.now
        if asked.key == "reset":
            self.reset_at = self._agenda.now
        if isinstance(asked.message, SentObstacles):
            self.pending_cubes.append((asked, cubes_of(asked.message.obstacles)))

    def named(self, asked: Asked, name: str) -> None:
        """Records the id of a goal or jog."""
        self.by_id.setdefault(name, []).append(asked)

    def waits(self, *keys: Key) -> bool:
        """Returns whether a request of a key is not answered."""
        return any(asked.key in keys for asked in self.open.values())

    def _heard(self, asked: Asked) -> None:
        self._dirty = True
        self._note(("planner answers", asked.number, asked.key, asked.payload))
        self.open.pop(asked.number, None)
        self.answered.append(asked)
        outcome = "accepted" if asked.accepted else "refused"
        self.counts[f"{asked.key} {outcome}"] += 1
        if asked.key in ("goal", "jog") and asked.accepted:
            assert asked.payload is not None
            self.goals.setdefault(asked.payload["id"], []).append(asked)
        if asked.key == "obstacles":
            for k, (pending, cubes) in enumerate(self.pending_cubes):
                if pending is asked:
                    if asked.accepted:
                        self.cubes, self.cubes_at = cubes, self._agenda.now
                    del self.pending_cubes[: k + 1 if asked.accepted else k]
                    self.pending_cubes = [entry for entry in self.pending_cubes if entry[0] is not asked]
                    break

    @property
    def known_cubes(self) -> tuple[Cube, ...]:
        """The obstacles that no stage may touch now, whichever of the pending requests is in force."""
        known = set(self.cubes)
        for _, cubes in self.pending_cubes:
            known &= set(cubes)
        return tuple(known)

    # --- the process

    def ended(self) -> None:
        """Records the end of a process, with all requests that it has not answered."""
        self._note("the planner is dead")
        self.counts["planners that ended"] += 1
        self.open.clear()
        self.cubes, self.pending_cubes, self.state, self.snapshot = (), [], None, None

    def quits(self, process: PlannerProcess) -> None:
        """Records that a process ends in order."""
        self.counts["planners that quit"] += 1

    def failed(self, reason: str) -> None:
        """Records that the core has ended its process."""
        self._note(("planner fails", reason))
        self.counts["planners that failed"] += 1

    def __call__(self, event: Event, now: float, wall: float, actions: Sequence[Action] | None) -> None:
        """Records a step of the core."""
        match event:
            case FromExecutor(Snapshot() as snapshot):
                before, self.snapshot = self.snapshot, snapshot
                if before is None or before.epoch != snapshot.epoch:
                    self.epoch_at = now
                if before is None or before.mode != snapshot.mode:
                    self.mode_at = now
                if before is None or _locks(before) != _locks(snapshot):
                    self.locks_at = now
                if before is None or (before.outputs, before.moving) != (snapshot.outputs, snapshot.moving):
                    self.moved_at = now
                return
            case FromExecutor(message):
                if isinstance(message, Welcome):
                    self.connected_to = message.instance
                self._note(("planner hears", message))
            case LinkDown(reason):
                self.link_down_at, self.snapshot = now, None
                self._note(("link down", reason))
            case Answered(number, answer, _):
                if isinstance(answer, Failed):
                    self.failed_at = now
                self._note(("worker answers", number, answer))
            case _:
                pass
        for action in actions or ():
            if isinstance(action, Publish) and action.key == "state" and self.snapshot is None:
                self.unfounded |= action.payload["mode"] in ("ready", "executing")

    def flush(self) -> None:
        """Does nothing: each step is recorded at once."""

    def acts(self, process: PlannerProcess, action: Action) -> None:
        """Records an action before it is carried out."""
        match action:
            case ToExecutor(message):
                if not isinstance(message, Alive):
                    self._dirty = True
                    self.sent.append(message)
                    self._note(("planner sends", message))
            case Start(number, task):
                self._note(("task", number, type(task).__name__))
            case Log(_, text):
                self._note(("planner logs", text))
                if "Traceback" in text:
                    self.strays.append(text)
            case Reply(number, payload) if number not in process.loop._replies:
                self.strays.append((number, payload))
            case _:
                pass

    # --- programs and results

    def observe(self, record: ExecutorRecord) -> None:
        """Records the programs that the executor has accepted and ended in this step."""
        for program, _ in record.step.accepted:
            self.running.add(program.name.split(" ", 1)[1])
        for ended, _ in record.step.ended:
            identity = Identity(record.instance, ended.program)
            self.ends[identity] = ended
            self.by_result[record.instance, ended.result] = identity

    def newest(self, name: str) -> Asked | None:
        """Returns the newest request for a goal or jog of an id."""
        return self.by_id[name][-1] if name in self.by_id else None

    def note_beginning(self, identity: Identity, name: str, states: int, locked: int) -> None:
        """Records where the arm is when a program begins.

        Args:
            identity: of the program.
            name: id of the goal.
            states: to which the boards drive the actuators, and the states of locked ones.
            locked: mask of the locked actuators.
        """
        asked, snapshot = self.newest(name), self.snapshot
        if asked is None or asked.key != "goal" or snapshot is None:
            return
        if snapshot.moving or snapshot.measured == snapshot.outputs:
            cubes = {cube for _, pending in self.pending_cubes for cube in pending} | set(self.cubes)
            self.beginnings[identity] = Beginning(asked.message, states, locked, tuple(sorted(cubes)))

    def published(self, result: PublishResult) -> None:
        """Records a result that is published now."""
        self._dirty = True
        self._note(("published", result))
        self.counts[f"result {result.payload['status']}"] += 1
        if result.identity in self.results and not result.payload.get("repeated"):
            self.twice.append(result.identity)
        self.results[result.identity] = result
        self.told.append(result)

    def recorded(self, record: Record) -> None:
        """Records what the ledger has reported as recorded."""
        if record.ended is not None:
            self.recorded_results.add(record.identity)

    def shown(self, key: str, payload: Payload) -> None:
        """Records any other payload."""
        self.counts[f"published {key}"] += 1
        if key == "state":
            self.state = payload
