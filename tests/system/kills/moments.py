"""The moments at which processes are killed: how each is brought about, and the steps of the planner at it."""

from __future__ import annotations

import math
import random
import signal
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, suppress
from typing import Any, NamedTuple

from hyperbit.controller.network.client import Message, Unanswered
from tests.system.kills.trigger import Order
from tests.system.stack.lives import Lives
from tests.system.stack.places import HOUR, LEFT, MIDDLE, RIGHT
from tests.waiting import SLOWNESS

PROCESSES = ("planner", "executor", "both")
FAR_AWAY = {"half_plane": {"point": [-30.0, 0.0], "normal": [1.0, 0.0]}, "name": "far"}
ACTION, EVENT = ("before", "after", "later"), ("before", "within", "after", "later")
PASSED = 10.0 * SLOWNESS  # [s]
MOST_REFUSED = 5
ZIGZAG = [0.08 * SLOWNESS * k for k in range(30)]


class Moment(NamedTuple):
    """A moment.

    Attributes:
        steps: of the trigger; "later" is a random time after "after".
        count: most times that a step is reached before the kill.
        latest: longest random time of "later" [s].
    """

    steps: tuple[str, ...]
    count: int
    latest: float
    scene: Callable[[Scene], AbstractContextManager[None]]


class Requests:
    """Sends requests of which some are never answered, because the planner is killed."""

    def __init__(self, lives: Lives) -> None:
        self._lives, self.refusals = lives, list[str]()
        self._threads: list[threading.Thread] = []
        self._goals: dict[str, bool] = {}
        self._answered_at = math.inf  # time of the last answer [s]

    def send(self, key: str, **payload: Any) -> bool | None:
        """Sends a request, and returns whether it was accepted; None if there is no answer."""
        answer: Message = {}
        with suppress(Unanswered):
            answer = self._lives.client.ask(key, **payload)
        goal = answer.get("id") or payload.get("id")
        if key in ("goal", "jog") and goal:
            self._goals[goal] = answer.get("accepted", False)
        if answer and not answer["accepted"]:
            self.refusals.append(answer["message"])
        accepted: bool | None = answer.get("accepted")
        return accepted

    def queue(self, *requests: dict[str, Any]) -> None:
        """Sends requests one after another, in a thread; a refused goal again, as a busy machine plans too late."""

        def send() -> None:
            for request in requests:
                for attempt in range(MOST_REFUSED):
                    number = {"id": f"{request['id']}{attempt}"} if "id" in request else {}
                    if self.send(**request | number) is not False:
                        break
            self._answered_at = time.monotonic()

        self._threads.append(threading.Thread(target=send))
        self._threads[-1].start()

    def over(self) -> bool:
        """Whether all requests were answered so long ago that their moment has passed."""
        return time.monotonic() > self._answered_at + PASSED

    def join(self) -> None:
        """Waits until all requests are answered, or will not be."""
        for thread in self._threads:
            thread.join()

    def goals(self) -> dict[str, bool]:
        """Returns the ids of goals and jogs, and whether a client received their acceptance."""
        return dict(self._goals)


class Scene(NamedTuple):
    lives: Lives
    requests: Requests
    chance: random.Random
    name: str

    def goal(self, suffix: str, count: int, last: float | None = None) -> dict[str, Any]:
        """A goal of waypoints as fast as the arm may follow, and one at a time `last`."""
        times = [*ZIGZAG[:count], *([] if last is None else [last])]
        first = self.chance.randrange(3)
        places = [(LEFT, RIGHT, MIDDLE)[(first + k) % 3] for k in range(len(times))]
        points = [{"t": time, "position": list(place)} for time, place in zip(times, places, strict=True)]
        return {"key": "goal", "id": f"{self.name} {suffix}", "waypoints": points}

    def label(self) -> str:
        labels = self.lives.system.arm.manipulator.actuators
        return labels[self.chance.randrange(len(labels))]


@contextmanager
def two_goals(scene: Scene) -> Iterator[None]:
    """A goal that a second one replaces; the second one ends by itself."""
    scene.requests.queue(scene.goal("a", 30, HOUR), scene.goal("b", 4))
    yield


@contextmanager
def a_goal(scene: Scene) -> Iterator[None]:
    """A goal that does not end by itself."""
    scene.requests.queue(scene.goal("a", 30, HOUR))
    yield


@contextmanager
def changed_obstacles(scene: Scene) -> Iterator[None]:
    """Obstacles that change in the middle of a goal: stages are withdrawn, checked, and sent again."""
    scene.requests.queue(scene.goal("a", 30, HOUR), {"key": "obstacles", "regions": [FAR_AWAY]})
    yield


@contextmanager
def a_stream(scene: Scene) -> Iterator[None]:
    """A goal, and a stream of set-points after it."""
    scene.requests.send(**scene.goal("a", 2))
    with scene.lives.publisher().streaming():
        yield


@contextmanager
def jogs(scene: Scene) -> Iterator[None]:
    """A jog of several actuators, and a second one."""
    labels = scene.chance.sample(list(scene.lives.system.arm.manipulator.actuators), 2)
    measured = scene.lives.client.state["measured"]
    states = {label: measured[scene.lives.system.arm.manipulator.actuators.index(label)] for label in labels}
    wanted = [{label: ("extended", "contracted")[states[label]]} for label in labels]
    scene.requests.queue(*({"key": "jog", "actuators": actuators} for actuators in wanted))
    yield


@contextmanager
def a_lock(scene: Scene) -> Iterator[None]:
    """An actuator that is locked, at rest or in the middle of a goal."""
    label, arm = scene.label(), scene.lives.system.arm
    state = scene.lives.client.state["measured"][arm.manipulator.actuators.index(label)]
    goal = scene.goal("a", *((30, HOUR) if scene.chance.random() < 0.5 else (2,)))  # type: ignore[arg-type]
    scene.requests.queue(goal, {"key": "degrade", "actuator": label, "state": state})
    yield


@contextmanager
def a_shutdown(scene: Scene) -> Iterator[None]:
    """The end of the planner in the middle of a goal."""
    scene.requests.send(**scene.goal("a", 30, HOUR))
    scene.lives.begun()
    scene.lives.system.planner.send(signal.SIGTERM)
    yield


MOMENTS = {
    "offered": Moment(ACTION, 2, 0.03, two_goals),
    "accepted": Moment(EVENT, 2, 0.03, two_goals),
    "replaced": Moment(ACTION, 2, 0.03, changed_obstacles),
    "settled": Moment(EVENT, 8, 0.03, a_goal),
    "ended": Moment(EVENT, 2, 0.03, two_goals),
    "published": Moment(("unmarked", "marked", "put", *EVENT), 2, 0.03, two_goals),
    "acknowledged": Moment(ACTION, 2, 0.03, two_goals),
    "following": Moment(ACTION, 15, 0.05, a_stream),
    "jogging": Moment(ACTION, 2, 0.1, jogs),
    "locking": Moment(ACTION, 1, 1.0, a_lock),
    "obstacles": Moment(ACTION, 1, 0.1, changed_obstacles),
    "shutdown": Moment(EVENT, 1, 0.3, a_shutdown),
}
TRIGGERS = {"jogging": "offered"}  # moments of the trigger by another name


def ordered(moment: str, victim: str, chance: random.Random, planner: int, executor: int) -> Order:
    steps, count, latest, _ = MOMENTS[moment]
    step = chance.choice(steps)
    delay = chance.uniform(0.0, latest) if step == "later" else 0.0
    pids = {"planner": [planner], "executor": [executor], "both": [executor, planner]}[victim]
    trigger = TRIGGERS.get(moment, moment)
    return Order(trigger, "after" if step == "later" else step, chance.randint(1, count), delay, pids)
