"""The time of the present step, tasks under way at the workers, and the numbers of programs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

from controller.planning.core.admission import Admission
from controller.planning.core.arm import ExecutorView
from controller.planning.core.events import Abandon, Action, Fail, Start
from controller.planning.core.tasks import Answer, Task

HUNG = 60.0  # [s] after which a worker that was told to abandon its task counts as hung

# Takes an answer, whether it is the task's last one, and the time [s].
OnAnswer = Callable[[Answer, bool, float], None]


@dataclass(eq=False)
class Moment:
    """The time of the present step, written by the core only.

    Attributes:
        now: by a clock that never goes back [s].
        wall: UNIX time [s].
    """

    now: float = 0.0
    wall: float = 0.0


@dataclass(eq=False)
class Job:
    """A task that a worker has."""

    task: Task
    on_answer: OnAnswer | None
    abandoned_at: float | None = None


class Jobs:
    """Starts tasks, and passes each answer to the part of the core that asked.

    Args:
        act: takes actions.
    """

    def __init__(self, act: Callable[[Action], None]) -> None:
        self._act = act
        self._last = 0
        self._jobs: dict[int, Job] = {}

    def start(self, task: Task, on_answer: OnAnswer) -> int:
        """Starts a task; returns its number."""
        self._last += 1
        self._jobs[self._last] = Job(task, on_answer)
        self._act(Start(self._last, task))
        return self._last

    def abandon(self, number: int | None, now: float) -> None:
        """Abandons a task: its answers are dropped from now on."""
        job = None if number is None else self._jobs.get(number)
        if number is not None and job is not None and job.abandoned_at is None:
            job.on_answer, job.abandoned_at = None, now
            self._act(Abandon(number))

    def answered(self, number: int, answer: Answer, last: bool, now: float) -> None:
        """Passes an answer on."""
        job = self._jobs.pop(number, None) if last else self._jobs.get(number)
        if job is not None and job.on_answer is not None:
            job.on_answer(answer, last, now)

    def tick(self, now: float) -> None:
        """Ends the process if a worker does not end a task that it was told to abandon."""
        for job in self._jobs.values():
            if job.abandoned_at is not None and now - job.abandoned_at > HUNG:
                job.abandoned_at = None
                kind = type(job.task).__name__
                self._act(Fail(f"a worker did not end its task {kind} within {HUNG:g} s: the process starts again"))

    def waiting(self) -> int:
        """Returns the number of tasks under way."""
        return len(self._jobs)


class ProgramNumbers:
    """Numbers programs and streams of set-points in ascending order."""

    def __init__(self) -> None:
        self._last = 0

    def next(self) -> int:
        """Returns a new number."""
        self._last += 1
        return self._last

    def at_least(self, number: int) -> None:
        """Continues after the executor's greatest number."""
        self._last = max(self._last, number)


class Shared(NamedTuple):
    """What all parts of the core share; each has one owner, the others ask."""

    view: ExecutorView
    admission: Admission
    jobs: Jobs
    moment: Moment
    numbers: ProgramNumbers
    act: Callable[[Action], None]
