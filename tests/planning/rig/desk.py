"""The planner's core on a simulated clock: workers that compute at once, and an executor that the test plays."""

from __future__ import annotations

import json
from collections import Counter, deque
from collections.abc import Iterator
from types import MappingProxyType
from typing import Any, TypeVar

import numpy as np
from msgspec import to_builtins

from hyperbit.controller.arm.arm import Arm
from hyperbit.controller.host.process import Log, Notify, Quit
from hyperbit.controller.messages.goals import refused
from hyperbit.controller.motion.stages.pacing import pace_of
from hyperbit.controller.obstacles.obstacles import NONE
from hyperbit.controller.planning.core.core import Beginning, Core
from hyperbit.controller.planning.core.events import (
    Abandon,
    Action,
    Answered,
    Arrival,
    CancelMessage,
    Disconnect,
    Event,
    Fail,
    Hurry,
    LinkDown,
    LiveArm,
    Publish,
    Published,
    PublishResult,
    Record,
    RecordCounts,
    Recorded,
    Reply,
    Request,
    SetpointArrived,
    Start,
    Tick,
    TipArrived,
    ToExecutor,
    Wake,
)
from hyperbit.controller.planning.core.tasks import Answer, BuildScene, BuildTables, Done, Failed, Task
from hyperbit.controller.planning.planner import RequestDecoder
from hyperbit.controller.program import (
    Alive,
    Cancel,
    Counts,
    Down,
    PlayableFaults,
    Stop,
    pack,
)
from hyperbit.controller.refusals.refusal import Refusal
from hyperbit.controller.workspace.densities import Densities
from tests.planning.rig.played_executor import DeskExecutor, Inbox
from tests.planning.rig.prompt_workers import PromptWorkers

T = TypeVar("T", bound=Task)
SETPOINT_EVERY = 0.02  # [s]
FAR = 1e9  # [s], so far ahead that look-ahead never decides a point early


class Desk:
    """A core with all that surrounds it.

    Attributes:
        now: monotonic time [s].
        wall: UNIX time [s].
        inbox: answers, feedback and results.
        said: the same and messages to the executor, by key, in their order.
        published: the latest `state` and `diagnostics`.
        entries: what the ledger has recorded.
        lines: of the log. notified: what systemd was told.
        publications: time and key of each publication but feedback [s].
        started: number of tasks of each kind.
        steps: number of the core's steps.
        failures: sentences with which the process would have ended.
        held: kinds of tasks that are not answered, until `release`.
        failing: kinds of tasks that fail.
        storing: whether results are noted as published, and entries as recorded, at once.
        delay: time that requests have waited before they reach the core [s].

    Args:
        published: results that were published before, by program.
        owed: goals that earlier planner processes accepted.
    """

    def __init__(
        self,
        arm: Arm,
        densities: Densities,
        published: Any = MappingProxyType({}),
        owed: Any = MappingProxyType({}),
        simulation: PlayableFaults | None = None,
    ) -> None:
        self.arm, self.now, self.wall = arm, FAR, 2 * FAR
        self.said = list[tuple[str, Any]]()
        self.inbox, self.published, self.entries = Inbox(self.said), dict[str, Any](), list[tuple[Any, ...]]()
        self.hurried = list[int]()  # numbers of tasks
        self.lines, self.failures = list[Log](), list[str]()
        self.counts = self.raised = (0,) * len(arm.manipulator.actuators)  # of the ledger; sent to an executor
        self.notified, self.publications = list[str](), list[tuple[float, str]]()
        self.started, self.steps = Counter[type[Task]](), 0
        self.held, self.failing, self.storing = set[type[Task]](), set[type[Task]](), True
        self.decode = RequestDecoder(arm).decode
        self._events, self.queued = deque[Event](), dict[int, Task]()
        self.names, self._numbers, self._wake = dict[int, str](), 0, float("inf")
        self.densities, self.workers = densities, PromptWorkers(arm, densities)
        [tables] = self.workers.perform(BuildTables(0, arm.locked.astype(np.uint8).tobytes()))
        [built] = self.workers.perform(BuildScene(0, NONE))
        self.beginning = Beginning(
            "t", tables, built.scene, built.total, self.counts, published, owed, simulation is not None
        )
        self.core = Core(arm, pace_of(arm.settings), self.beginning)
        self.simulation, self.delay = simulation, 0.0
        self.executor = DeskExecutor(self, len(arm.manipulator.actuators))
        self._waiting = list[Action]()  # publications and records that are held back

    def post(self, *events: Event) -> None:
        """Has the core handle events, and all that follows from them."""
        self._events.extend(events)
        while self._events:
            self.steps += 1
            for action in self.core.step(self._events.popleft(), self.now, self.wall):
                self._carry_out(action)

    def pass_time(self, seconds: float) -> None:
        """Lets time pass; the core wakes when it asked to."""
        until = self.now + seconds
        while (now := min(max(self._wake, self.now), until)) < until:
            self._set_time(now + 1e-6)
            self.post(Tick())
        self._set_time(until)
        self.post(Tick())

    def show(self, **changes: Any) -> None:
        """Sends a snapshot of the executor, and lets what follows happen."""
        self.executor.show(**changes)
        self.settle()

    def quit(self) -> None:
        self.post(Quit())

    def drop(self, reason: str = "the executor closed the connection") -> None:
        self.post(LinkDown(reason))

    def settle(self) -> None:
        """Lets what is due at once happen, so that `state` is current."""
        self.pass_time(0.01)

    def release(self, *kinds: type[Task]) -> None:
        """Answers the held tasks of some kinds, and holds them no longer."""
        self.held -= set(kinds)
        for number, task in list(self.queued.items()):
            if type(task) in kinds:
                self._answer(number, task)
        self.post()

    def store(self) -> None:
        """Notes held results as published, and held entries as recorded."""
        waiting, self._waiting = self._waiting, []
        for action in waiting:
            self._store(action)
        self.post()

    def _set_time(self, now: float) -> None:
        self.wall += now - self.now
        self.now = now

    def _carry_out(self, action: Action) -> None:
        match action:
            case Reply(number, payload):
                told = to_builtins(payload._asdict() if isinstance(payload, LiveArm) else payload)
                self.inbox.put(self.names.pop(number), told)
            case Publish("feedback", payload):
                self.inbox.put("feedback", to_builtins(payload))
            case Publish(key, payload):
                self.published[key] = to_builtins(payload)
                self.publications.append((self.now, key))
            case Notify(text):
                self.notified.append(text)
            case PublishResult():
                self.inbox.put("inherited" if action.inherited else "result", to_builtins(action.result))
                self._store(action) if self.storing else self._waiting.append(action)
            case Record():
                self._store(action) if self.storing else self._waiting.append(action)
            case RecordCounts(counts):
                self.counts = counts
            case ToExecutor(message):
                if isinstance(message, Counts):
                    self.raised = message.counts
                elif not isinstance(message, Alive):
                    self._to_executor(message)
            case Start(number, task):
                self.queued[number] = task
                self.started[type(task)] += 1
                if type(task) not in self.held:
                    self._answer(number, task)
            case Abandon(number):
                if self.queued.pop(number, None) is not None:
                    self._events.append(Answered(number, Done(), True))
            case Hurry(number):
                self.hurried.append(number)
            case Wake(at):
                self._wake = at
            case Log():
                self.lines.append(action)
            case Fail(reason) | Disconnect(reason):
                self.failures.append(reason)

    def _store(self, action: Action) -> None:
        if isinstance(action, PublishResult):
            self._events.append(Published(action.number))
        elif isinstance(action, Record):
            kinds = ["accepted"] * (action.accepted is not None) + ["ended"] * (action.ended is not None)
            self.entries.append(("+".join(kinds), action))
            self._events.append(Recorded(action.entry))

    def _answer(self, number: int, task: Task) -> None:
        answers = list(self._answers(task))
        self.queued.pop(number)
        self._events.extend(Answered(number, answer, k == len(answers) - 1) for k, answer in enumerate(answers))

    def _answers(self, task: Task) -> Iterator[Answer]:
        try:
            if type(task) in self.failing:
                raise MemoryError("no memory")
            yield from self.workers.perform(task)
        except Refusal as refusal:
            yield refusal.data
        except Exception as error:
            yield Failed(repr(error))

    def ask(self, key: Any, payload: Any = None, name: str = "reply") -> int:
        """Sends a request as the gateway does; its answer comes to the inbox by `name`. Returns its number."""
        data = payload if isinstance(payload, bytes) else b"" if payload is None else json.dumps(payload).encode()
        try:
            message = self.decode(key, data)
        except Refusal as refusal:
            self.inbox.put(name, to_builtins(refused(refusal)))
            return 0
        self._numbers += 1
        self.names[self._numbers] = name
        if key == "stop":
            self._to_executor(Stop(self._numbers))
        elif isinstance(message, CancelMessage) and message.goal is None:
            self._to_executor(Cancel(self._numbers, None, "canceled; the arm holds"))
        self.post(Request(Arrival(self._numbers, self.now - self.delay), key, message, self.wall))
        return self._numbers

    def _to_executor(self, message: Down) -> None:
        self.executor.messages.append(message)
        self.said.append(("executor", message))

    def setpoint(self, payload: Any, sender: str = "") -> None:
        """Sends a set-point: JSON, or bytes."""
        self._numbers += 1
        data = payload if isinstance(payload, bytes) else json.dumps(payload).encode()
        self.post(SetpointArrived(data, Arrival(self._numbers, self.now - self.delay), sender))

    def stream(self, position: list[float], seconds: float, sender: str = "") -> None:
        """Sends a set-point each 0.02 s, for a time [s]."""
        for _ in range(round(seconds / SETPOINT_EVERY)):
            self.setpoint({"position": position, "tolerance": {"position": 0.01}}, sender)
            self.pass_time(SETPOINT_EVERY)

    def measure(self, position: list[float], age: float = 0.01, **fields: Any) -> None:
        """Sends a measured tip."""
        self._numbers += 1
        payload = {"position": position, "stamp": self.wall - age, **fields}
        self.post(TipArrived(json.dumps(payload).encode(), Arrival(self._numbers, self.now)))

    def waiting(self, kind: type[T]) -> tuple[int, T]:
        """Returns number and content of the one task of a kind that is held."""
        ((number, task),) = [(number, task) for number, task in self.queued.items() if isinstance(task, kind)]
        return number, task

    def goal(self, *configurations: tuple[int, ...], step: float = 0.2, name: str = "a", **fields: Any) -> None:
        """Sends a goal whose waypoints are the tips of configurations."""
        waypoints = [{"t": step * k, "position": self.tip(*c)} for k, c in enumerate(configurations)]
        self.ask("goal", {"id": name, "waypoints": waypoints, **fields})

    def tip(self, *configuration: int) -> list[float]:
        return self.arm.manipulator.tip(np.array(configuration))[:2, 3].tolist()  # type: ignore[no-any-return]

    def bits(self, *configuration: int) -> int:
        states = self.arm.manipulator.actuator_states(np.array(configuration))
        return sum(int(s) << k for k, s in enumerate(states))

    def packed(self, *configuration: int) -> bytes:
        return pack(self.bits(*configuration), len(self.arm.manipulator.actuators))

    def state(self) -> dict[str, Any]:
        self.settle()
        return dict(self.published["state"])

    def diagnostics(self) -> dict[str, Any]:
        self.pass_time(1.1)
        return dict(self.published["diagnostics"])

    @property
    def logs(self) -> list[str]:
        return [line.text for line in self.lines]
