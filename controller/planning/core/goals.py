"""Requests for motion: each goal or jog waits, is planned from where the arm is, and is offered to the executor."""

import logging
import math
import traceback
from collections.abc import Callable
from functools import partial

import msgspec

from hyperbit.controller.host.journal import fields_of_refusal
from hyperbit.controller.host.process import Log
from hyperbit.controller.messages.goals import refused
from hyperbit.controller.motion.decoding.goal import GoalMessage, Jog
from hyperbit.controller.motion.stages.program import packed
from hyperbit.controller.planning.core import tasks
from hyperbit.controller.planning.core.arm import obstruction
from hyperbit.controller.planning.core.events import Request
from hyperbit.controller.planning.core.goal import Goal, jog_stages, make_program, unsure_of
from hyperbit.controller.planning.core.parts import Parts
from hyperbit.controller.planning.core.premises import Premises
from hyperbit.controller.planning.core.programs import Programs
from hyperbit.controller.program import Accepted, Declined
from hyperbit.controller.refusals.reasons import Reason
from hyperbit.controller.refusals.refusal import Refusal, no_motion

MOST_WAITING = 16  # requests
EXECUTOR_TIMEOUT = 2.0  # [s] for the executor's answer; it answers within milliseconds
NEWER_WITHIN = 0.2  # [s]; a snapshot comes 20 times a second
MOVED = (Reason.MOVED_SINCE_PLANNED, Reason.SWITCH_NOT_CONFIRMED)  # the goal is planned again from the new state
MOST_LINES = 5  # refusals logged in one second
IDLE = 0.02  # [s] without a request before the next search is prepared
REHEARSE_EVERY, REHEARSE_FOR = 0.025, 2.0  # [s] between two rehearsals, and after the last goal


class Goals:
    """Requests for motion, one after the other.

    A goal is planned from where the arm is, or from where its running stage ends. If the arm, the obstacles or the
    locks change before the program is sent, the goal is planned anew at once. A request that was not accepted by its
    time is refused at any stage.
    """

    def __init__(self, parts: Parts, premises: Premises, programs: Programs, prepares: bool) -> None:
        self.quitting = False
        self._parts, self._view, self._moment, self._jobs = parts, parts.view, parts.moment, parts.jobs
        self._requests = parts.requests
        self._premises, self._locks, self._programs = premises, premises.locks, programs
        self._preparation = Preparation(parts, premises, programs, prepares)
        self.due = math.inf  # when `advance` must be called again, without another event [s]
        self._second, self._lines = 0, 0

    @property
    def all(self) -> list[Goal]:
        """The requests that the executor has not accepted; the first one is being planned, or offered."""
        return [goal for goal in self._requests.of(Goal) if goal.state in ("waiting", "offered")]

    @property
    def preparing(self) -> int | None:
        return self._preparation.task

    def check(self) -> None:
        """Asserts that each request waits for something that will come in time; see `Core.check`."""
        waiting = self.all
        assert len(waiting) <= MOST_WAITING + 1, f"{len(waiting)} requests wait"
        for goal in waiting:
            is_first = goal is waiting[0]
            assert goal.state == "waiting" or (is_first and goal.state == "offered"), f"{goal.id} is {goal.state}"
            assert is_first or goal.job is None, f"{goal.id} is planned, and is not the first"
            if goal.state == "waiting":
                assert self._moment.now < goal.begin_by, f"{goal.id} waits too long"
                assert self.due <= goal.begin_by, f"nothing wakes {goal.id}"
                assert not self._parts.admission.barred(goal.ticket, goal.id), f"{goal.id} is barred, and waits"
        for first in waiting[:1]:
            if first.state == "waiting" and first.ticket.epoch is not None:
                waits = first.job is not None or first.waits is not None
                assert waits or self._premises.basis() is None, f"{first.id} waits for nothing"

    def queue(self, request: Request) -> None:
        wanted, name = request.message, f"{self._parts.name}{request.number:x}"
        assert isinstance(wanted, GoalMessage | Jog)
        name = f"jog-{name}" if isinstance(wanted, Jog) else wanted.id or name
        begin_by, ticket = request.arrival.at + wanted.patience, self._parts.admission.arrive(request.number)
        goal, before = Goal(request.number, self._moment.now, ticket, wanted, name, request.wall, begin_by), self.all
        self._requests.add(goal)
        if len(before) > MOST_WAITING:
            self._end(goal, Refusal(Reason.BUSY, most=MOST_WAITING, what="goals"))
            return
        for first in before[:1]:
            self._jobs.hurry(first.job)
        self._preparation.end()
        self._programs.pause_improvement()

    def advance(self) -> None:
        """Advances the first request as far as possible. Call at the end of each step."""
        self.due = math.inf
        self.refuse_late()
        while waiting := self.all:
            if self._attempt(waiting[0], self._proceed):
                return
        self.due = self._preparation.advance()

    def refuse_late(self) -> None:
        """Refuses the requests that may no longer begin. A request that the executor has is exempt."""
        for goal in self.all:
            if goal.state == "waiting":
                self._attempt(goal, self._check)

    def _attempt(self, goal: Goal, advance: Callable[[Goal], None]) -> bool:
        try:
            advance(goal)
            return True
        except Refusal as refusal:
            self._end(goal, refusal)
        except Exception:
            self._parts.act(Log(logging.ERROR, f"{goal.id} failed\n{traceback.format_exc()}"))
            self._end(goal, Refusal(Reason.INTERNAL_ERROR))
        return False

    # --- the executor

    def accepted(self, message: Accepted) -> None:
        if (goal := self._programs.offered) is not None and goal.program.program == message.program:
            self._parts.admission.end_streams(goal.ticket)
            self._preparation.begin(goal.wanted)
        self._programs.accepted(message)

    def declined(self, message: Declined) -> None:
        goal = self._programs.offered
        if goal is None or goal.program.program != message.program:
            return
        self._programs.withdraw(goal)
        if message.refused.reason in MOVED:
            goal.planned, goal.why = None, Refusal(Reason.ARM_MOVED)
            goal.waits, goal.since = self._view.state, self._moment.now
        else:
            self._end(goal, message.refused.refusal)

    def lost(self, reason: str) -> None:
        if (goal := self._programs.offered) is not None:
            self._programs.withdraw(goal)
            self._end(goal, Refusal(Reason.EXECUTOR_LOST, why=reason))

    # --- one request; each of these functions raises Refusal if the request cannot be carried out

    def _check(self, goal: Goal) -> None:
        if self.quitting:
            raise Refusal(Reason.SHUTTING_DOWN)
        if self._parts.admission.barred(goal.ticket, goal.id):
            raise Refusal(Reason.OVERTAKEN)
        if self._moment.now >= goal.begin_by:
            mode, reason = self._locks.mode()
            if goal.why is None and mode not in ("ready", "executing"):
                raise no_motion(mode, reason)
            raise goal.why or Refusal(Reason.TOO_LATE_TO_BEGIN)
        self.due = min(self.due, goal.begin_by)

    def _proceed(self, goal: Goal) -> None:
        if goal.state == "offered":
            if self._waits(goal, EXECUTOR_TIMEOUT):
                return
            self._programs.give_up(goal)
            raise Refusal(Reason.EXECUTOR_SILENT, seconds=EXECUTOR_TIMEOUT)
        if goal.waits is not None and goal.waits is self._view.state and self._waits(goal, NEWER_WITHIN):
            return
        goal.waits = None
        if goal.ticket.epoch is None:
            if self._waits(goal, EXECUTOR_TIMEOUT):
                return
            raise Refusal(Reason.EXECUTOR_BEHIND) if self._view.connected else no_motion(*self._locks.mode())
        basis, (mode, reason), rebuilding = self._premises.basis(), self._locks.mode(), self._locks.rebuilding
        if not rebuilding and (self._view.state is None or mode not in ("ready", "executing")):
            raise no_motion(mode, reason)
        if not rebuilding and self._locks.tables is None:
            raise Refusal(Reason.LOCKS_CHANGING)
        if goal.job is not None and goal.basis != basis:
            self._jobs.abandon(goal.job)
            goal.job, goal.why = None, self._stale(goal, basis)
        if basis is None or goal.job is not None:  # None: tables or obstacles are built
            return
        if goal.planned is not None and goal.basis == basis:
            self._offer(goal)
        else:
            self._plan(goal, basis)

    def _stale(self, goal: Goal, basis: tasks.Basis | None) -> Refusal:
        assert goal.basis is not None
        if self._locks.rebuilding or (basis is not None and basis.tables != goal.basis.tables):
            return Refusal(Reason.LOCKS_CHANGING)
        if basis is None or basis.scene != goal.basis.scene:
            return Refusal(Reason.OBSTACLES_CHANGING)
        return Refusal(Reason.ARM_MOVED)

    def _waits(self, goal: Goal, longest: float) -> bool:
        """Returns whether a request may wait longer; if so, stores until when [s]."""
        self.due = min(self.due, goal.since + longest)
        return self._moment.now < goal.since + longest

    def _plan(self, goal: Goal, basis: tasks.Basis) -> None:
        """Starts to plan a request from the arm's present state, unless the time for its planning is over."""
        state, wanted, now = self._view.state, goal.wanted, self._moment.now
        assert state is not None
        if goal.basis is not None and goal.planned is not None:
            goal.why = self._stale(goal, basis)
        goal.basis, goal.planned, goal.since = basis, None, now
        task: tasks.Task
        if isinstance(wanted, Jog):
            goal.planned = jog_stages(self._parts, state, wanted.states)
            if basis.scene.free or unsure_of(state) is not None:
                self._offer(goal)
                return
            task = tasks.CheckStages(basis.scene, basis.start.commanded, tuple(map(packed, goal.planned)))
        else:
            if (refusal := obstruction(state, *self._locks.mode())) is not None:
                raise refusal
            if wanted.deadline is not None:
                goal.plan_by = now + wanted.deadline if goal.plan_by is None else goal.plan_by
                if now >= goal.plan_by:
                    raise goal.why or Refusal(Reason.TOO_LATE_TO_BEGIN)
                wanted = msgspec.structs.replace(wanted, deadline=goal.plan_by - now)
            task = tasks.PlanGoal(wanted, goal.received, self._premises.correction(), basis)
        goal.job = self._jobs.start(task, partial(self._answered, goal))
        if len(self.all) > 1:
            self._jobs.hurry(goal.job)

    def _answered(self, goal: Goal, answer: tasks.Answer) -> None:
        goal.job = None
        match answer:
            case tasks.Planned():
                goal.planned = answer
            case tasks.Checked(None):
                pass
            case tasks.Checked(str(collision)):
                self._end(goal, Refusal(Reason.START_COLLIDES, collision=collision))
            case _:
                self._end(goal, tasks.refusal_of(answer))

    def _offer(self, goal: Goal) -> None:
        running, state = self._programs.current, self._view.state
        assert state is not None
        if isinstance(goal.wanted, GoalMessage) and running is not None and running.id == goal.id:
            raise Refusal(Reason.ALREADY_RUNNING, goal=goal.id)
        make_program(self._parts, goal, state)
        goal.since = self._moment.now
        self._programs.offer(goal)

    # --- the end of waiting

    def _end(self, goal: Goal, refusal: Refusal) -> None:
        act, second = self._parts.act, int(self._moment.now)
        if goal is self.all[0]:
            self._preparation.begin(goal.wanted)
        self._requests.end(goal, refused(refusal, goal.id))
        self._lines, self._second = 1 if second != self._second else self._lines + 1, second
        if self._lines <= MOST_LINES:
            fields = fields_of_refusal(goal.id, refusal.reason.value, refusal.code)
            act(Log(logging.INFO, f"{goal.id} refused: {refusal}", fields))
        elif self._lines == MOST_LINES + 1:
            act(Log(logging.INFO, f"more than {MOST_LINES} requests are refused in this second"))


class Preparation:
    """Prepares the next search from where the arm is, once for each start, while no request for motion waits.

    A processor that was idle for a tenth of a second needs twice as long for a search, because its caches are cold. For
    a while after a goal, the goal is therefore planned again and again without effect. The next goal finds warm caches.
    """

    def __init__(self, parts: Parts, premises: Premises, programs: Programs, prepares: bool) -> None:
        self._parts, self._premises, self._programs, self._prepares = parts, premises, programs, prepares
        self._job: int | None = None
        self._prepared: tasks.Basis | None = None  # for which the next search is prepared
        self._last: GoalMessage | None = None
        self._idle_since, self._rehearse_until = 0.0, -math.inf  # [s]

    @property
    def task(self) -> int | None:
        return self._job

    def end(self) -> None:
        self._parts.jobs.abandon(self._job)
        self._job = self._prepared = None

    def begin(self, planned: GoalMessage | Jog | None) -> None:
        """Records that no request is being planned any more; `planned` was the last one."""
        self._idle_since = now = self._parts.moment.now
        if isinstance(planned, GoalMessage) and len(planned.waypoints) == 1:
            self._last, self._rehearse_until = planned, now + REHEARSE_FOR

    def advance(self) -> float:
        """Prepares or rehearses when due; returns when to call again while no request waits [s]."""
        state, now = self._parts.view.state, self._parts.moment.now
        if not self._prepares or self._job is not None:
            return math.inf
        if now < self._idle_since + IDLE:
            return self._idle_since + IDLE
        ready = state is not None and state.configuration is not None and not self._programs.improving
        if not ready or (basis := self._premises.basis()) is None:
            return math.inf
        rehearsal = self._last if now < self._rehearse_until and basis.scene.free else None
        if basis != self._prepared or rehearsal is not None:
            self._prepared = basis
            self._job = self._parts.jobs.start(tasks.PrepareSearch(basis, rehearsal), self._answered)
        return math.inf

    def _answered(self, answer: tasks.Answer) -> None:
        self._job = None
        self._idle_since = self._parts.moment.now + REHEARSE_EVERY - IDLE
