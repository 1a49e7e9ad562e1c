"""The workers of a planner's process: the product's, whose answers are late, never come, or are errors."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from functools import partial
from random import Random

from hyperbit.controller.arm.arm import Arm
from hyperbit.controller.planning.core.events import Answered, Event
from hyperbit.controller.planning.core.tasks import (
    Answer,
    Done,
    Failed,
    FollowSetpoint,
    PlanGoal,
    Planned,
    Task,
)
from hyperbit.controller.planning.workers.computations import MakeSolver
from hyperbit.controller.planning.workers.pool import THREADS, Workers
from hyperbit.controller.search.clock import WorkClock
from hyperbit.controller.workspace.densities import Densities
from tests.simulation.agenda import Agenda
from tests.simulation.verdict import require

ABANDONED_WITHIN = 0.05  # [s]
DEARER, DEAREST = 1.3, 0.2  # price of a look at the clock: a multiple of the last one's, and most [s]
LATER = 1.0  # [s] after a task that was late, in which others make up for it
DRAWN = "drawn"  # text of the exception of a task that fails
USUAL_DELAY = 0.01  # [s], mean time of a task


class LookClock(WorkClock):
    """The time of the world, to which each look at the clock adds: a search ends by its effort, on every computer.

    In a task each look costs more than the last, so that a search begins in no hurry and still ends soon.
    """

    def __init__(self, agenda: Agenda, first: float) -> None:
        super().__init__()
        self._agenda, self._first, self._price, self._fails = agenda, first, first, False

    def now(self) -> float:
        if self._fails:
            raise ValueError(DRAWN)
        self.charge(self._price)
        self._price = min(DEARER * self._price, DEAREST)
        return self._agenda.now + super().now()

    def begin(self, fails: bool) -> None:
        """Begins a task: its work counts from now on. `fails`: its first look at the clock raises."""
        self.charge(-super().now())
        self._price, self._fails = self._first, fails


class Mood:
    """How the workers of a world behave now.

    Attributes:
        delay: mean time of a task [s].
        fails: share of the tasks that end by an exception.
        hangs: whether the next task of a goal is never answered.
        errs: share of the plans that end before their goal; `erred_at` is the time of the last one [s].
    """

    def __init__(self) -> None:
        self.errs, self.erred_at = 0.0, -math.inf
        self.mend()

    @property
    def disturbed(self) -> bool:
        """Whether tasks may be late, fail or hang."""
        return self.delay > USUAL_DELAY or self.fails > 0.0 or self.hangs

    def mend(self) -> None:
        self.delay, self.fails, self.hangs = USUAL_DELAY, 0.0, False


class LateWorkers:
    """The workers of one process; each kind has one thread, which carries out its tasks one after the other."""

    def __init__(
        self,
        agenda: Agenda,
        random: Random,
        mood: Mood,
        clock: LookClock,
        parts: tuple[Arm, Densities, list[float], MakeSolver],
        post: Callable[[Event], None],
    ) -> None:
        arm, densities, weights, make = parts
        self._agenda, self._random, self._mood, self._clock, self._post = agenda, random, mood, clock, post
        self._found = deque[Event]()
        self._workers = Workers(arm, densities, weights, self._found.append, self._never, make, threaded=False)
        self._lanes: dict[str, deque[tuple[int, Task]]] = {name: deque() for name in THREADS}
        self._lane_of = {kind: name for name, kinds in THREADS.items() for kind in kinds}
        self._abandoned: set[int] = set()
        self._hung = -1  # number of the task that is never answered
        self._late_until = 0.0  # end of what began while the workers were disturbed [s]

    def _never(self, reason: str) -> None:
        raise AssertionError(reason)

    @property
    def late(self) -> bool:
        """Whether a task began while the workers were disturbed, and may go on."""
        hangs = any(lane and lane[0][0] == self._hung for lane in self._lanes.values())
        return hangs or self._agenda.now < self._late_until

    def end(self) -> None:
        """Ends the workers with their process: nobody sees their answers."""
        for lane in self._lanes.values():
            lane.clear()

    def start(self, number: int, task: Task) -> None:
        """Starts a task, as soon as its thread is free."""
        name = self._lane_of[type(task)]
        self._workers.start(number, task)
        self._lanes[name].append((number, task))
        if len(self._lanes[name]) == 1:
            self._begin(name)

    def abandon(self, number: int) -> None:
        """Ends a task soon, unless it hangs."""
        self._abandoned.add(number)
        self._workers.abandon(number)
        running = [name for name, lane in self._lanes.items() if lane and lane[0][0] == number != self._hung]
        for name in running:
            self._agenda.after(self._random.uniform(0.0, ABANDONED_WITHIN), partial(self._end, name, number, Done()))

    def hurry(self, number: int) -> None:
        self._workers.hurry(number)

    def _begin(self, name: str) -> None:
        """Does the work of the next task of a thread; its answers come later."""
        number, task = self._lanes[name][0]
        if self._mood.hangs and isinstance(task, PlanGoal) and number not in self._abandoned:
            self._mood.hangs, self._hung = False, number
            return
        abandoned = number in self._abandoned
        fails = not abandoned and self._random.random() < self._mood.fails
        self._clock.begin(fails)
        self._workers.carry_out(name)
        found = [event for event in self._found if isinstance(event, Answered)]
        self._found.clear()
        text, answers = f"{type(task).__name__} is answered by {found}", deque(event.answer for event in found)
        require([event.last for event in found] == [*(False for _ in found[1:]), True], f"{text}: which is the last?")
        require(not abandoned or list(answers) == [Done()], f"{text}, and was abandoned before its turn")
        require(fails or not isinstance(answers[-1], Failed), f"internal error: {text}")
        delay = 0.0 if abandoned else self._random.expovariate(1 / self._mood.delay)
        if fails and not isinstance(answers[-1], Failed):  # a task that does not look at the clock
            answers = deque([Failed(DRAWN)])
        elif isinstance(answers[0], Planned) and self._random.random() < self._mood.errs:
            answers, self._mood.erred_at = deque([cut_short(answers[0])]), self._agenda.now
        delay *= 0.3 if isinstance(task, FollowSetpoint) else 1.0
        self._after(delay, lambda: self._proceed(name, number, answers))

    def _after(self, delay: float, happen: Callable[[], None]) -> None:
        if self._mood.disturbed:
            self._late_until = max(self._late_until, self._agenda.now + delay + LATER)
        self._agenda.after(delay, happen)

    def _proceed(self, name: str, number: int, answers: deque[Answer]) -> None:
        """Gives the next answer of a task that runs and is wanted."""
        lane = self._lanes[name]
        if not lane or lane[0][0] != number or (number in self._abandoned and len(answers) > 1):
            return
        if len(answers) == 1:
            self._end(name, number, answers[0])
            return
        self._post(Answered(number, answers.popleft(), False))
        delay = self._random.expovariate(0.2 / self._mood.delay)
        self._after(delay, lambda: self._proceed(name, number, answers))

    def _end(self, name: str, number: int, answer: Answer) -> None:
        """Gives the last answer of a task, and begins the next task of its thread."""
        lane = self._lanes[name]
        if lane and lane[0][0] == number:
            lane.popleft()
            self._abandoned.discard(number)
            self._post(Answered(number, answer, True))
            if lane:
                self._begin(name)


def cut_short(planned: Planned) -> Planned:
    """Returns a plan that makes no switch to its last point."""
    *points, last = planned.points
    stay = points[-1].stages[-1:] if points else (planned.plan.start.outputs,)
    switches = sum(point.switches for point in points)
    proof = planned.proof._replace(switches=switches, bound=0.0, certificate="unknown")
    return planned._replace(points=(*points, last._replace(stages=stay, switches=0)), proof=proof)
