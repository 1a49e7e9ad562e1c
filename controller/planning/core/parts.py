"""Shared by all parts of the core: the time, requests and their order, tasks under way, and the numbers of programs.

A cancel, stop or reset bars every goal and every stream of set-points that arrived before it. The planner decides by
the numbers of arrivals, the executor by epoch. While a cancel is unanswered, new requests belong to the epoch that
begins with its answer.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, TypeVar

from hyperbit.controller.messages.goals import Answer
from hyperbit.controller.planning.core import tasks
from hyperbit.controller.planning.core.arm import ExecutorView
from hyperbit.controller.planning.core.events import Abandon, Action, Fail, Hurry, Reply, Start
from hyperbit.controller.planning.core.tasks import PrepareSearch, Task

if TYPE_CHECKING:
    from hyperbit.controller.motion.stages.pacing import Pace

HUNG = 60.0  # [s] after which a worker with an abandoned task counts as hung
MOST_UNRESOLVED = 256  # tickets without an epoch; each stream of set-points without an executor leaves one
MOST_CANCELED = 256  # remembered cancels of ids, for requests that arrived earlier but reach the core later
OnAnswer = Callable[[tasks.Answer], None]


@dataclass(eq=False)
class Ticket:
    number: int
    epoch: int | None  # of the executor at arrival; None while it is not known
    waits_for: frozenset[int]  # the executor's requests that were unanswered at arrival, and may begin a new epoch


class Admission:
    """Decides which requests are barred, by the numbers of their arrivals and by the executor's epoch.

    A stop, a cancel of all, a needed reset and a lost connection bar all requests that arrived before, also those that
    reach the core after it. A cancel of a goal bars all earlier requests of its id.
    """

    def __init__(self) -> None:
        self._latest = self._barred = self._replaced = 0  # numbers of arrivals
        self.canceled: dict[str, int] = {}  # number of the latest cancel of each id, the oldest first
        self._pending: frozenset[int] = frozenset()  # the executor's requests that may begin a new epoch
        self._epoch: int | None = None  # of the last snapshot
        self._current = False  # whether that snapshot came after the last answer
        self.unresolved: deque[Ticket] = deque(maxlen=MOST_UNRESOLVED)

    def arrive(self, number: int) -> Ticket:
        self._latest = max(self._latest, number)
        ticket = Ticket(number, self._epoch if self._current and not self._pending else None, self._pending)
        if ticket.epoch is None:
            self.unresolved.append(ticket)
        return ticket

    def bar(self, request: int) -> None:
        """Bars all earlier requests: a cancel, stop or reset of this number goes to the executor."""
        self._barred = max(self._barred, request - 1)
        self.fence(request)

    def bar_id(self, goal: str, request: int) -> None:
        """Bars all earlier requests of an id: its cancel has arrived as this number."""
        self.canceled.pop(goal, None)
        self.canceled[goal] = request
        if len(self.canceled) > MOST_CANCELED:
            del self.canceled[next(iter(self.canceled))]

    def fence(self, request: int) -> None:
        """Records a request to the executor that begins a new epoch if the executor accepts it."""
        self._latest = max(self._latest, request)
        self._pending |= {request}

    def end_streams(self, ticket: Ticket) -> None:
        """Ends the streams of set-points that began before an accepted goal."""
        self._replaced = max(self._replaced, ticket.number)

    def answered(self, request: int) -> None:
        """Records that the executor answered such a request, or that it could not be sent."""
        if request in self._pending:
            self._pending -= {request}
            self._current = False

    def snapshot(self, epoch: int) -> None:
        self._epoch, self._current = epoch, True
        for ticket in [ticket for ticket in self.unresolved if not ticket.waits_for & self._pending]:
            ticket.epoch = epoch
            self.unresolved.remove(ticket)

    def lost(self) -> None:
        """Bars all earlier requests: the connection to the executor is lost."""
        self._barred = max(self._barred, self._latest)
        self._pending, self._epoch, self._current = frozenset(), None, False

    def check(self) -> None:
        """Asserts that tickets lack an epoch only as long as none is known; see `Core.check`."""
        assert len(self.canceled) <= MOST_CANCELED
        late = [ticket for ticket in self.unresolved if ticket.epoch is not None]
        assert not late, f"{late} have an epoch, and wait for one"
        assert self._pending or not self._current or not self.unresolved, f"{self.unresolved} wait for no answer"

    def barred(self, ticket: Ticket, goal: str | None = None) -> bool:
        """Returns whether a cancel, stop, reset or fault came after a request; `goal` is its id, if it has one."""
        changed = ticket.epoch is not None and self._epoch is not None and ticket.epoch != self._epoch
        canceled = goal is not None and ticket.number <= self.canceled.get(goal, 0)
        return ticket.number <= self._barred or canceled or changed

    def stream_ended(self, ticket: Ticket) -> bool:
        """Returns whether a stream of set-points has ended; `ticket` is that of its first set-point."""
        return ticket.number <= self._replaced or self.barred(ticket)


@dataclass(eq=False)
class Moment:  # the time of the present step, written by the core only: see `Core.step`
    now: float = 0.0
    wall: float = 0.0


@dataclass(eq=False)
class Job:
    task: Task
    on_answer: OnAnswer | None  # None: the task is abandoned
    abandoned_at: float | None = None


class Jobs:
    def __init__(self, moment: Moment, act: Callable[[Action], None]) -> None:
        self._moment, self._act, self._last = moment, act, 0
        self._jobs: dict[int, Job] = {}

    def start(self, task: Task, on_answer: OnAnswer) -> int:
        self._last += 1
        self._jobs[self._last] = Job(task, on_answer)
        self._act(Start(self._last, task))
        return self._last

    def abandon(self, number: int | None) -> None:
        """Abandons a task, if there is one: its later answers are dropped."""
        if number is not None and (job := self._jobs.get(number)) is not None and job.on_answer is not None:
            job.on_answer, job.abandoned_at = None, self._moment.now
            self._act(Abandon(number))

    def hurry(self, number: int | None) -> None:
        """Ends the search of a task as soon as it has an answer, because another request waits for the worker."""
        if number is not None and (job := self._jobs.get(number)) is not None and job.on_answer is not None:
            self._act(Hurry(number))

    def answered(self, number: int, answer: tasks.Answer, last: bool) -> None:
        job = self._jobs.pop(number, None) if last else self._jobs.get(number)
        if job is not None and job.on_answer is not None:
            job.on_answer(answer)

    def prepares(self, number: int) -> bool:
        return (job := self._jobs.get(number)) is not None and isinstance(job.task, PrepareSearch)

    def tick(self) -> None:
        """Ends the process if a worker does not end an abandoned task."""
        for job in self._jobs.values():
            if job.abandoned_at is not None and self._moment.now - job.abandoned_at > HUNG:
                job.abandoned_at = None
                kind = type(job.task).__name__
                self._act(Fail(f"a worker did not end its task {kind} within {HUNG:g} s: the process starts again"))

    @property
    def waiting(self) -> int:
        return len(self._jobs)

    def awaited(self) -> set[int]:
        return {number for number, job in self._jobs.items() if job.on_answer is not None}


@dataclass(eq=False)
class Pending:
    """A request that is not over; each kind of request has its own record."""

    number: int  # of its arrival
    since: float  # its arrival, or when its present wait began [s]
    job: int | None = field(default=None, kw_only=True)  # number of the task that it waits for


Kind = TypeVar("Kind", bound=Pending)


class PendingRequests:
    """The one table of requests, by number, in the order in which they reached the core."""

    def __init__(self, jobs: Jobs, act: Callable[[Action], None]) -> None:
        self._jobs, self._act = jobs, act
        self._pending: dict[int, Pending] = {}

    def add(self, request: Pending) -> None:
        self._pending[request.number] = request

    def of(self, kind: type[Kind]) -> list[Kind]:
        """Returns the requests of a kind, the oldest first; the list stays when the table changes."""
        return [request for request in self._pending.values() if isinstance(request, kind)]

    def find(self, kind: type[Kind], number: int) -> Kind | None:
        request = self._pending.get(number)
        return request if isinstance(request, kind) else None

    def end(self, request: Pending, answer: Answer) -> None:
        """Answers a request, unless it is over, and abandons its task."""
        if self._pending.get(request.number) is request:
            self._jobs.abandon(request.job)
            self._act(Reply(request.number, answer))
            self.forget(request)

    def forget(self, request: Pending) -> None:
        """Removes a request that was answered before."""
        del self._pending[request.number]


class Parts:
    def __init__(
        self, view: ExecutorView, pace: Pace, name: str, act: Callable[[Action], None], simulated: bool = False
    ) -> None:
        self.view, self.pace, self.act = view, pace, act
        self.name = name  # of this process, unique; a part of ids
        self.simulated = simulated  # whether the boards of the arm are simulated
        self.moment, self.admission = Moment(), Admission()
        self.jobs = Jobs(self.moment, act)
        self.requests = PendingRequests(self.jobs, act)
        self.last_number = 0  # of a program or stream of set-points

    def check(self, tasks: list[int | None]) -> None:
        """Asserts that tasks that are waited for run, and no tickets wait without a reason; see `Core.check`.

        `tasks` are waited for beside those of the requests.
        """
        tasks = [*(request.job for request in self.requests.of(Pending)), *tasks]
        waited = [task for task in tasks if task is not None]
        assert len(waited) == len(set(waited)), f"two wait for a task: {waited}"
        lost = set(waited) - self.jobs.awaited()
        assert not lost, f"tasks {lost} are waited for, and nobody carries them out"
        self.admission.check()

    def next_number(self) -> int:
        self.last_number += 1
        return self.last_number
