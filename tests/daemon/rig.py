"""A control loop on boards that live in memory, and on a clock that the test sets."""

import threading
from collections.abc import Sequence
from typing import Any

import numpy as np

from controller.daemon.avoidance import Avoidance
from controller.daemon.degradation import Degradation
from controller.daemon.events import Cancel, Follow, Planned, Reset, Stop
from controller.daemon.loop import PERIOD, ControlLoop
from controller.daemon.state import Diagnostics, Snapshot
from controller.motion.pacing import Staged
from controller.motion.plan import Plan
from controller.motion.trajectory import through
from controller.search.solution import Solution
from drivers.faults import BusBusy, Fault, Leaving
from drivers.status import Status
from tests.arms import paper_arm

TRAVEL = 0.05
ARM = paper_arm(2)


A, B, C = (1, 2), (3, 4), (7, 0)  # configurations
LOST = Fault("board-lost", "can0/1", "board can0/1: no heartbeat")


def states(configuration: tuple[int, int]) -> list[int]:
    """Its actuator states."""
    return ARM.actuator_states(configuration).tolist()


class FakeBoards:
    """Boards without a bus: what is committed is measured a travel time later."""

    def __init__(self) -> None:
        self.states = np.zeros(len(ARM.actuators), dtype=np.int8)
        self.commits: list[list[int]] = []
        self.ticks: list[float] = []
        self.starts = 0
        self.missing: list[Fault] = []
        self.halt: Fault | None = None
        self.busy = self.stuck = self.slow = self.returned = False
        self.broken: set[str] = set()
        self.held: list[int] = []
        self._pending: tuple[float, np.ndarray] | None = None
        self._now = 0.0
        self._tell: Any = None

    def subscribe(self, callback: Any) -> None:
        self._tell = callback

    def start(self) -> list[Fault]:
        self.starts += 1
        self._break("start")
        self._pending = None
        return list(self.missing)

    def measured(self) -> np.ndarray:
        self._break("measured")
        return self.states.copy()

    def outputs(self) -> np.ndarray:
        return np.array(self.commits[-1] if self.commits else np.maximum(self.states, 0), dtype=np.uint8)

    def settle(self, now: float) -> bool:
        return True

    @property
    def sensed(self) -> np.ndarray:
        return np.ones(len(ARM.actuators), dtype=np.bool_)

    def degrade(self, held: np.ndarray) -> None:
        self.held = held.tolist()

    def passive(self) -> tuple[Fault, ...]:
        return ()

    def back(self) -> bool:
        return self.returned

    def halted(self, now: float) -> Fault | None:
        halt, self.halt = self.halt, None
        return halt

    def hold(self) -> None:
        self._break("hold")

    def commit(self, states: np.ndarray, now: float) -> None:
        self._break("commit")
        if self.busy:
            raise BusBusy("the queue is full")
        self.commits.append(states.tolist())
        self._pending = (now + TRAVEL, states.astype(np.int8))

    def tick(self, now: float) -> None:
        self._now = now
        self.ticks.append(now)
        self._break("tick")
        if self._pending is None or self.slow or now < self._pending[0]:
            return
        if self.stuck:
            self.fail(Fault("stuck", "1.left", "actuator 1.left is stuck"))
        else:
            self.states = self._pending[1]
        self._pending = None

    def moving(self, now: float) -> bool:
        return self._pending is not None

    def status(self) -> Status:
        return Status((), ())

    def fail(self, fault: Fault) -> None:
        self._tell(fault)

    def _break(self, verb: str) -> None:
        if verb in self.broken:
            raise RuntimeError(f"{verb} is broken")


class FakeLedger:
    fault = None

    def __init__(self) -> None:
        self.counts = np.zeros(len(ARM.actuators), dtype=int)
        self.goals: dict[int, list[Any]] = {}
        self._intended: np.ndarray = self.counts - 1

    def faults(self) -> tuple[Fault, ...]:
        return ()

    def intend(self, outputs: np.ndarray, states: np.ndarray) -> None:
        self._intended = np.where(outputs != states, states.astype(np.int8), -1)

    def resolve(self, outputs: np.ndarray) -> np.ndarray:
        switched = np.flatnonzero(self._intended == outputs)
        self.counts[switched] += 1
        self._intended = np.full_like(self._intended, -1)
        return switched

    def accepted(self, number: int, goal: str, waypoints: int) -> None:
        assert number not in self.goals
        self.goals[number] = [goal]

    def ended(self, number: int, status: str, code: int, message: str, switches: int) -> None:
        self.goals[number].append(status)


class FakeNotifier:
    def __init__(self) -> None:
        self.watchdog: float | None = 0.4
        self.sent: list[str] = []

    def send(self, *states: str) -> None:
        self.sent += states


class Rig:
    """The loop and all it says; `go` lets time pass."""

    def __init__(
        self,
        inrush: int | None = None,
        rest: float = 0.0,
        degradation: Degradation | None = None,
        avoidance: Avoidance | None = None,
    ) -> None:
        self.now, self.awaited = 1000.0, {"start-up", "avoidance"}
        self.boards, self.ledger, self.notifier = FakeBoards(), FakeLedger(), FakeNotifier()
        self.published: list[tuple[str, dict[str, Any]]] = []
        self.snapshots: list[Snapshot] = []
        self.diagnostics: list[Diagnostics] = []
        self.replies: list[tuple[str, dict[str, Any]]] = []
        self._arrival = 0
        self.loop = ControlLoop(
            ARM, self.boards, TRAVEL, lambda key, payload: self.published.append((key, dict(payload))),
            self, self.ledger, self.notifier, self.arrival, lambda: self.now, inrush, rest,
            degradation=degradation, avoidance=avoidance,
        )  # fmt: skip
        self.loop.begin()
        self.settle()

    def show(self, snapshot: Snapshot) -> None:
        self.snapshots.append(snapshot)

    def diagnose(self, diagnostics: Diagnostics) -> None:
        self.diagnostics.append(diagnostics)

    def arrival(self) -> int:
        self._arrival += 1
        return self._arrival

    def goal(self, name: str, *configurations: Sequence[int], arrival: int | None = None, **fields: Any) -> Planned:
        """A goal with a plan through these configurations, `step` seconds between two."""
        plan = planned(*configurations, **fields)
        return Planned(arrival or self.arrival(), lambda p: self.replies.append((name, dict(p))), name, plan)

    def request(self, kind: type[Cancel | Stop | Reset]) -> None:
        name = kind.__name__.lower()
        self.loop.inbox.hand_over(kind(self.arrival(), lambda p: self.replies.append((name, dict(p)))))

    def run(self, name: str, *configurations: Sequence[int], **fields: Any) -> None:
        self.loop.inbox.hand_over(self.goal(name, *configurations, **fields))

    def wish(self, stream: int, configuration: Sequence[int] | None, lasting: float = 0.25) -> Follow:
        """What a moving goal asks for from the configuration of now; `stream` is the arrival of its first setpoint."""
        chosen = None if configuration is None else np.array(configuration, dtype=np.int64)
        return Follow(stream, self.loop.commanded, chosen, self.now + lasting, "following a setpoint")

    def follow(self, stream: int, configuration: Sequence[int] | None, lasting: float = 0.25) -> None:
        self.loop.inbox.put(self.wish(stream, configuration, lasting))

    def go(self, seconds: float = PERIOD) -> None:
        """Lets time pass, a tick at a time; each step acts on one event at most."""
        for _ in range(max(round(seconds / PERIOD), 1)):
            self.now += PERIOD
            self.loop.step()
            self.settle()

    def settle(self) -> None:
        """Waits for the end of a start-up that the last step began, and of a look at what is touched."""
        for thread in threading.enumerate():
            if thread.name in self.awaited:
                thread.join(30)

    @property
    def results(self) -> list[tuple[str, str]]:
        return [(payload["id"], payload["status"]) for key, payload in self.published if key == "result"]

    @property
    def last_result(self) -> dict[str, Any]:
        return [payload for key, payload in self.published if key == "result"][-1]


def planned(*configurations: Sequence[int], step: float = 0.2, stamp: float | None = None, error: float = 0.0) -> Plan:
    chosen = [np.array(configuration, dtype=np.int64) for configuration in configurations]
    tips = [ARM.tip(configuration) for configuration in chosen]
    positions = np.array([tip[:2, 3] for tip in tips]) + np.array([error, 0])
    times = step * np.arange(len(chosen))
    solutions = tuple(Solution(c, tip, error, 1, True, 0.0, 1.0) for c, tip in zip(chosen, tips, strict=True))
    transitions = tuple(Staged(ARM.actuator_states(configuration)[None], 0.0) for configuration in chosen)
    return Plan(through(times, positions, 0.002, stamp), solutions, transitions)


def leaving_late(rig: Rig, after: float) -> list[float]:
    """Lets the first SYNC leave a while [s] after its commit; returns when, once it is known."""
    commit, left_at = rig.boards.commit, list[float]()

    def leaves_late(states: np.ndarray, now: float) -> None:
        commit(states, now)
        if not left_at:
            left_at.append(now + after)
            raise Leaving("the SYNC has not left yet")

    rig.boards.commit = leaves_late  # type: ignore[method-assign]
    rig.boards.settle = lambda now: now >= max(left_at, default=0.0)  # type: ignore[method-assign]
    return left_at
