"""The planner's core on a simulated clock: workers that compute at once, and an executor that the test plays."""

from __future__ import annotations

import json
from collections import deque
from collections.abc import Iterator
from types import MappingProxyType
from typing import Any

import numpy as np

from hyperbit.controller.arm.arm import Arm
from hyperbit.controller.host.process import Log, Quit
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
    FromExecutor,
    Hurry,
    LinkDown,
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
    ToExecutor,
    Wake,
    refused,
)
from hyperbit.controller.planning.core.tasks import Answer, BuildScene, BuildTables, Done, Failed, Task
from hyperbit.controller.planning.planner import RequestDecoder
from hyperbit.controller.program import (
    VERSION,
    Alive,
    Cancel,
    Counts,
    Down,
    PlayableFaults,
    Stop,
    Up,
    Welcome,
    pack,
    unpack,
)
from hyperbit.controller.refusals.refusal import Refusal
from hyperbit.controller.workspace.densities import Densities
from tests.planning.rig.played_executor import PlayedExecutor
from tests.planning.rig.prompt_workers import PromptWorkers

FAR = 1e9  # [s], so far ahead that look-ahead never decides a point early


class DeskExecutor(PlayedExecutor):
    """The executor of a desk.

    Attributes:
        messages: of the planner, but keep-alives and counts.
    """

    def __init__(self, desk: Desk, actuators: int) -> None:
        self._desk, self.messages = desk, deque[Down]()
        super().__init__(actuators)

    def greet(self, greatest: int = 0) -> None:
        self.send(
            Welcome(VERSION, "small", "d" * 64, self.instance, (0,) * self.actuators, greatest, self._desk.simulation)
        )
        self.show()

    def now(self) -> float:
        return self._desk.now

    def send(self, message: Up) -> None:
        self._desk.post(FromExecutor(message))

    def take(self) -> Down | None:
        return self.messages.popleft() if self.messages else None

    def waiting(self) -> deque[Down]:
        return self.messages


class Inbox:
    def __init__(self, said: list[tuple[str, Any]]) -> None:
        self.payloads = deque[tuple[str, dict[str, Any]]]()
        self._said = said

    def put(self, key: str, payload: Any) -> None:
        self.payloads.append((key, dict(payload)))
        self._said.append((key, dict(payload)))

    def next(self, key: str) -> dict[str, Any]:
        assert self.payloads, f"no {key} came"
        came, payload = self.payloads.popleft()
        assert came == key, f"{came} {payload} came where {key} was expected"
        return payload

    @property
    def empty(self) -> bool:
        return not self.payloads


class Desk:
    """A core with all that surrounds it.

    Attributes:
        now: monotonic time [s].
        wall: UNIX time [s].
        inbox: answers, feedback and results.
        said: the same and messages to the executor, by key, in their order.
        published: the latest `state` and `diagnostics`.
        entries: what the ledger has recorded.
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
        self.logs, self.failures, self.counts = list[str](), list[str](), (0,) * len(arm.manipulator.actuators)
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
                self.inbox.put(self.names.pop(number), payload)
            case Publish("feedback", payload):
                self.inbox.put("feedback", payload)
            case Publish(key, payload):
                self.published[key] = payload
            case PublishResult():
                self.inbox.put("inherited" if action.inherited else "result", action.payload)
                self._store(action) if self.storing else self._waiting.append(action)
            case Record():
                self._store(action) if self.storing else self._waiting.append(action)
            case RecordCounts(counts):
                self.counts = counts
            case ToExecutor(message):
                if not isinstance(message, Alive | Counts):
                    self._to_executor(message)
            case Start(number, task):
                self.queued[number] = task
                if type(task) not in self.held:
                    self._answer(number, task)
            case Abandon(number):
                if self.queued.pop(number, None) is not None:
                    self._events.append(Answered(number, Done(), True))
            case Hurry(number):
                self.hurried.append(number)
            case Wake(at):
                self._wake = at
            case Log(_, text):
                self.logs.append(text)
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
            self.inbox.put(name, refused(refusal))
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

    def setpoint(self, payload: bytes, number: int, sender: str = "") -> None:
        self.post(SetpointArrived(payload, Arrival(number, self.now - self.delay), sender))

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
    def outputs(self) -> int:
        return unpack(self.executor.state.outputs)
