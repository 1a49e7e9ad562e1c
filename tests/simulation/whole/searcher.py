"""The workers of a planner's process: they answer tasks after drawn times, late, never, or by an exception."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator
from random import Random

from hyperbit.controller.planning.core.events import Answered, Event
from hyperbit.controller.planning.core.tasks import (
    Answer,
    DescribePlan,
    Done,
    Failed,
    FollowSetpoint,
    ImprovePlan,
    PlanGoal,
    Task,
)
from hyperbit.controller.planning.workers.pool import THREADS
from tests.simulation.agenda import Agenda
from tests.simulation.whole.exact_search import ExactSearch

ABANDONED_WITHIN = 0.05  # [s]
LONG_PLAN = 4.0  # times as long as other searches takes a plan that is only described
USUAL_DELAY = 0.01  # [s], mean time of a task


class Mood:
    """How the workers of a world behave now.

    Attributes:
        delay: mean time of a task [s].
        fails: share of the tasks that end by an exception.
        hangs: whether the next task of a goal is never answered.
    """

    def __init__(self) -> None:
        self.mend()

    @property
    def disturbed(self) -> bool:
        """Whether tasks may be late, fail or hang."""
        return self.delay > USUAL_DELAY or self.fails > 0.0 or self.hangs

    def mend(self) -> None:
        self.delay, self.fails, self.hangs = USUAL_DELAY, 0.0, False


class Searcher:
    """The workers of one process; each kind has one thread, which carries out its tasks one after the other."""

    def __init__(
        self, agenda: Agenda, random: Random, search: ExactSearch, mood: Mood, post: Callable[[Event], None]
    ) -> None:
        self._agenda, self._random, self._search, self._mood, self._post = agenda, random, search, mood, post
        self._lanes: dict[str, deque[tuple[int, Task]]] = {name: deque() for name in THREADS}
        self._lane_of = {kind: name for name, kinds in THREADS.items() for kind in kinds}
        self._abandoned: set[int] = set()
        self._hung = -1  # number of the task that is never answered

    @property
    def busy(self) -> int:
        return sum(map(len, self._lanes.values()))

    def end(self) -> None:
        """Ends the workers with their process: nobody sees their answers."""
        for lane in self._lanes.values():
            lane.clear()

    def start(self, number: int, task: Task) -> None:
        """Starts a task, as soon as its thread is free."""
        lane = self._lanes[self._lane_of[type(task)]]
        lane.append((number, task))
        if len(lane) == 1:
            self._begin(lane)

    def abandon(self, number: int) -> None:
        """Ends a task soon, unless it hangs."""
        self._abandoned.add(number)
        for lane in self._lanes.values():
            if lane and lane[0][0] == number and number != self._hung:
                self._agenda.after(self._random.uniform(0.0, ABANDONED_WITHIN), lambda: self._end(number, Done()))

    def hurry(self, number: int) -> None:
        """Changes nothing: no task of the simulation searches longer because of its gap."""

    def _begin(self, lane: deque[tuple[int, Task]]) -> None:
        number, task = lane[0]
        delay = self._random.expovariate(1 / self._mood.delay)
        if number in self._abandoned:
            self._agenda.after(0.0, lambda: self._end(number, Done()))
        elif self._mood.hangs and isinstance(task, PlanGoal):
            self._mood.hangs, self._hung = False, number
        elif self._random.random() < self._mood.fails:
            self._agenda.after(delay, lambda: self._end(number, Failed("ValueError: drawn")))
        else:
            delay *= 0.3 if isinstance(task, FollowSetpoint) else LONG_PLAN if isinstance(task, DescribePlan) else 1.0
            self._agenda.after(delay, lambda: self._proceed(number, self._search.answers(task), task))

    def _proceed(self, number: int, answers: Iterator[Answer], task: Task) -> None:
        if not self._runs(number) or number in self._abandoned:
            return
        answer = next(answers)
        if isinstance(task, ImprovePlan) and not isinstance(answer, Done):
            self._post(Answered(number, answer, False))
            delay = self._random.expovariate(0.2 / self._mood.delay)
            self._agenda.after(delay, lambda: self._proceed(number, answers, task))
        else:
            self._end(number, answer)

    def _runs(self, number: int) -> bool:
        return any(lane and lane[0][0] == number for lane in self._lanes.values())

    def _end(self, number: int, answer: Answer) -> None:
        """Gives the last answer of a task, and begins the next task of its thread."""
        for lane in self._lanes.values():
            if lane and lane[0][0] == number:
                lane.popleft()
                self._abandoned.discard(number)
                self._post(Answered(number, answer, True))
                if lane:
                    self._begin(lane)
