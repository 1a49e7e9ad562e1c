"""The moments at which processes are killed: how each is brought about, and the steps of the planner at it."""

from __future__ import annotations

import math
import random
import signal
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
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


class Scene:
    """The requests of one moment, some of which are never answered, because the planner is killed.

    Attributes:
        goals: ids of goals and jogs, and whether a client received their acceptance.
    """

    def __init__(self, lives: Lives, chance: random.Random, name: str) -> None:
        self.lives, self.chance, self.name = lives, chance, name
        self.goals, self.refusals = dict[str, bool](), list[str]()
        self._threads: list[threading.Thread] = []
        self._answered_at = math.inf  # time of the last answer [s]

    def send(self, key: str, **payload: Any) -> bool | None:
        """Sends a request, and returns whether it was accepted; None if there is no answer."""
        answer: Message = {}
        with suppress(Unanswered):
            answer = self.lives.client.ask(key, **payload)
        goal, accepted = answer.get("id") or payload.get("id"), answer.get("accepted")
        if key in ("goal", "jog") and goal:
            self.goals[goal] = bool(accepted)
        if accepted is False:
            self.refusals.append(answer["message"])
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
        for thread in self._threads:
            thread.join()

    def goal(self, suffix: str, count: int, last: float | None = None) -> dict[str, Any]:
        """A goal of waypoints as fast as the arm may follow, and one at a time `last`."""
        times = [*(0.08 * SLOWNESS * k for k in range(count)), *([] if last is None else [last])]
        first = self.chance.randrange(3)
        points = [{"t": t, "position": (LEFT, RIGHT, MIDDLE)[(first + k) % 3]} for k, t in enumerate(times)]
        return {"key": "goal", "id": f"{self.name} {suffix}", "waypoints": points}

    def measured(self) -> dict[str, int]:
        """The state of each actuator."""
        labels = self.lives.system.arm.manipulator.actuators
        return dict(zip(labels, self.lives.client.state["measured"], strict=True))


def two_goals(scene: Scene) -> None:
    """A goal that a second one replaces; the second one ends by itself."""
    scene.queue(scene.goal("a", 30, HOUR), scene.goal("b", 4))


def a_goal(scene: Scene) -> None:
    """A goal that does not end by itself."""
    scene.queue(scene.goal("a", 30, HOUR))


def changed_obstacles(scene: Scene) -> None:
    """Obstacles that change in the middle of a goal: stages are withdrawn, checked, and sent again."""
    scene.queue(scene.goal("a", 30, HOUR), {"key": "obstacles", "regions": [FAR_AWAY]})


def jogs(scene: Scene) -> None:
    """A jog of one actuator, and of a second one."""
    chosen = scene.chance.sample(sorted(scene.measured().items()), 2)
    scene.queue(*({"key": "jog", "actuators": {label: ("extended", "contracted")[k]}} for label, k in chosen))


def a_lock(scene: Scene) -> None:
    """An actuator that is locked, at rest or in the middle of a goal."""
    label, state = scene.chance.choice(sorted(scene.measured().items()))
    goal = scene.goal("a", 30, HOUR) if scene.chance.random() < 0.5 else scene.goal("a", 2)
    scene.queue(goal, {"key": "degrade", "actuator": label, "state": state})


def a_shutdown(scene: Scene) -> None:
    """The end of the planner in the middle of a goal."""
    scene.send(**scene.goal("a", 30, HOUR))
    scene.lives.begun()
    scene.lives.system.planner.send(signal.SIGTERM)


def a_goal_before_a_stream(scene: Scene) -> None:
    scene.send(**scene.goal("a", 2))


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
    begin: Callable[[Scene], None]


MOMENTS = {
    "offered": Moment(ACTION, 2, 0.03, two_goals),
    "accepted": Moment(EVENT, 2, 0.03, two_goals),
    "replaced": Moment(ACTION, 2, 0.03, changed_obstacles),
    "settled": Moment(EVENT, 8, 0.03, a_goal),
    "ended": Moment(EVENT, 2, 0.03, two_goals),
    "published": Moment(("unmarked", "marked", "put", *EVENT), 2, 0.03, two_goals),
    "acknowledged": Moment(ACTION, 2, 0.03, two_goals),
    "following": Moment(ACTION, 15, 0.05, a_goal_before_a_stream),
    "jogging": Moment(ACTION, 2, 0.1, jogs),
    "locking": Moment(ACTION, 1, 1.0, a_lock),
    "obstacles": Moment(ACTION, 1, 0.1, changed_obstacles),
    "shutdown": Moment(EVENT, 1, 0.3, a_shutdown),
}
TRIGGERS = {"jogging": "offered"}  # moments of the trigger by another name


@contextmanager
def played(moment: str, scene: Scene) -> Iterator[None]:
    """Brings a moment about; a stream of set-points lasts as long as the context."""
    MOMENTS[moment].begin(scene)
    if moment == "following":
        with scene.lives.publisher().streaming():
            yield
    else:
        yield
    scene.join()


def ordered(moment: str, victim: str, chance: random.Random, planner: int, executor: int) -> Order:
    steps, count, latest, _ = MOMENTS[moment]
    step = chance.choice(steps)
    delay = chance.uniform(0.0, latest) if step == "later" else 0.0
    pids = {"planner": [planner], "executor": [executor], "both": [executor, planner]}[victim]
    trigger = TRIGGERS.get(moment, moment)
    return Order(trigger, "after" if step == "later" else step, chance.randint(1, count), delay, pids)
