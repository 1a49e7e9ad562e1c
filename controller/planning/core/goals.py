"""Requests for motion: each goal or jog waits, is planned from where the arm is, and is offered to the executor."""

from __future__ import annotations

import logging
import math
import traceback
from collections import deque
from collections.abc import Callable
from functools import partial

import msgspec

from hyperbit.controller.host.journal import fields_of_refusal
from hyperbit.controller.host.process import Log
from hyperbit.controller.motion.decoding.goal import GoalMessage, Jog
from hyperbit.controller.planning.core import tasks
from hyperbit.controller.planning.core.arm import ArmState, obstruction, packed
from hyperbit.controller.planning.core.events import Reply, Request, refused
from hyperbit.controller.planning.core.offers import Motion, goal_program, jog_program, jog_stages, unsure_of
from hyperbit.controller.planning.core.parts import Parts, Ticket
from hyperbit.controller.planning.core.preparation import Preparation
from hyperbit.controller.program import Accepted, Declined
from hyperbit.controller.refusals.reasons import Reason
from hyperbit.controller.refusals.refusal import Refusal, no_motion

MOST_WAITING = 16  # requests
EXECUTOR_TIMEOUT = 2.0  # [s] for the executor's answer; it answers within milliseconds
NEWER_WITHIN = 0.2  # [s]; a snapshot comes 20 times a second
MOVED = (Reason.MOVED_SINCE_PLANNED, Reason.SWITCH_NOT_CONFIRMED)  # the goal is planned again from the new state
MOST_LINES = 5  # refusals logged in one second


class Goals:
    """Requests for motion, one after the other.

    A goal is planned from where the arm is, or from where its running stage ends. If the arm, the obstacles or the
    locks change before the program is sent, the goal is planned anew at once. A request that was not accepted by its
    time is refused, wherever it is.

    Attributes:
        due: when `advance` must be called again, without another event [s].
    """

    def __init__(self, parts: Parts, prepares: bool) -> None:
        self.quitting = False
        self._parts, self._view, self._moment, self._act = parts, parts.view, parts.moment, parts.act
        self._locks, self._obstacles, self._programs = parts.locks, parts.obstacles, parts.programs
        self._preparation = Preparation(parts, prepares)
        self._waiting = deque[Motion]()
        self._current: Motion | None = None
        self.due = math.inf
        self._second, self._lines = 0, 0

    @property
    def waiting(self) -> int:
        """Number of requests that wait, the one that is planned included."""
        return len(self._waiting) + (self._current is not None)

    def queue_motion(self, request: Request, ticket: Ticket) -> None:
        """Queues a goal or jog, or refuses it at once."""
        wanted, name = request.message, f"{self._parts.name}{request.number:x}"
        assert isinstance(wanted, GoalMessage | Jog)
        name = f"jog-{name}" if isinstance(wanted, Jog) else wanted.id or name
        begin_by = request.arrival.at + wanted.patience
        motion = Motion(request.number, ticket, wanted, name, request.wall, begin_by, self._moment.now)
        if len(self._waiting) >= MOST_WAITING:
            self._refuse(motion, Refusal(Reason.BUSY, most=MOST_WAITING, what="goals"))
        else:
            self._waiting.append(motion)
            if self._current is not None:
                self._parts.jobs.hurry(self._current.job)
            self._preparation.end()
            self._programs.pause_improvement()

    def waits_for_turn(self, goal: str) -> bool:
        """Returns whether a goal of this id was not offered to the executor yet."""
        return any(motion.id == goal and motion.program is None for motion in self._motions)

    def advance(self) -> None:
        """Refuses what may no longer begin, and brings the first request as far as it can go now.

        Call at the end of each step.
        """
        self.due = math.inf
        self.refuse_late()
        while True:
            if self._current is None:
                if not self._waiting:
                    self.due = self._preparation.advance()
                    return
                self._current = self._waiting.popleft()
                self._current.since = self._moment.now
            if self._attempt(self._current, self._proceed):
                return

    def refuse_late(self) -> None:
        """Refuses the requests that may no longer begin, but for one that the executor has."""
        for motion in self._motions:
            if motion.program is None:
                self._attempt(motion, self._check)

    @property
    def _motions(self) -> list[Motion]:
        return [*filter(None, [self._current]), *self._waiting]

    def _attempt(self, motion: Motion, advance: Callable[[Motion], None]) -> bool:
        """Advances a request; returns False if that has ended it, with the refusal that was raised."""
        try:
            advance(motion)
            return True
        except Refusal as refusal:
            self._end(motion, refusal)
        except Exception:
            self._act(Log(logging.ERROR, f"{motion.id} failed\n{traceback.format_exc()}"))
            self._end(motion, Refusal(Reason.INTERNAL_ERROR))
        return False

    # --- the executor

    def accepted(self, message: Accepted) -> None:
        """Hands a request over whose program the executor has accepted."""
        motion = self._current
        self._programs.accepted(message)
        if motion is not None and motion.program == message.program:
            self._parts.admission.end_streams(motion.ticket)
            self._drop(motion)

    def declined(self, message: Declined) -> None:
        """Offers a program again from where the arm has moved to, or refuses the request."""
        self._programs.withdraw(message.program)
        motion = self._current
        if motion is None or motion.program != message.program:
            return
        motion.program = None
        if message.refused.reason in MOVED:
            motion.planned, motion.why = None, Refusal(Reason.ARM_MOVED)
            motion.waits, motion.since = self._view.state, self._moment.now
        else:
            self._end(motion, message.refused.refusal)

    def lost(self, reason: str) -> None:
        """Refuses the request whose program the executor has not answered, because the connection is lost."""
        motion = self._current
        if motion is not None and motion.program is not None:
            self._end(motion, Refusal(Reason.EXECUTOR_LOST, why=reason))

    # --- one request

    def _check(self, motion: Motion) -> None:
        """Checks that a request may still begin.

        Raises:
            Refusal: it is barred, or its time is over.
        """
        if self.quitting:
            raise Refusal(Reason.SHUTTING_DOWN)
        if self._parts.admission.barred(motion.ticket, motion.id):
            raise Refusal(Reason.OVERTAKEN)
        if self._moment.now >= motion.begin_by:
            mode, reason = self._locks.mode()
            if motion.why is None and mode not in ("ready", "executing"):
                raise no_motion(mode, reason)
            raise motion.why or Refusal(Reason.TOO_LATE_TO_BEGIN)
        self.due = min(self.due, motion.begin_by)

    def _proceed(self, motion: Motion) -> None:
        """Plans a request, offers it, or lets it wait.

        Raises:
            Refusal: the request cannot be carried out.
        """
        if motion.program is not None:
            if self._waits(motion, EXECUTOR_TIMEOUT):
                return
            self._programs.give_up(motion.program)
            raise Refusal(Reason.EXECUTOR_SILENT, seconds=EXECUTOR_TIMEOUT)
        if motion.waits is not None and motion.waits is self._view.state and self._waits(motion, NEWER_WITHIN):
            return
        motion.waits = None
        if motion.ticket.epoch is None:
            if self._waits(motion, EXECUTOR_TIMEOUT):
                return
            raise Refusal(Reason.EXECUTOR_BEHIND)
        basis = self._basis()
        if motion.job is not None and motion.basis != basis:
            self._parts.jobs.abandon(motion.job)
            motion.job, motion.why = None, self._stale(motion, basis)
        if basis is None or motion.job is not None:
            return
        if motion.planned is not None and motion.basis == basis:
            self._offer(motion, basis)
        else:
            self._plan(motion, basis)

    def _basis(self) -> tasks.Basis | None:
        """Returns what a plan made now holds for; None while tables or obstacles are built.

        Raises:
            Refusal: the arm takes no motion.
        """
        mode, reason = self._locks.mode()
        if self._locks.rebuilding:
            return None
        if self._view.state is None or mode not in ("ready", "executing"):
            raise no_motion(mode, reason)
        if self._locks.tables is None:
            raise Refusal(Reason.LOCKS_CHANGING)
        return self._parts.basis()

    def _stale(self, motion: Motion, basis: tasks.Basis | None) -> Refusal:
        """Returns why a plan is made anew."""
        assert motion.basis is not None
        if self._locks.rebuilding or (basis is not None and basis.tables != motion.basis.tables):
            return Refusal(Reason.LOCKS_CHANGING)
        if basis is None or basis.scene != motion.basis.scene:
            return Refusal(Reason.OBSTACLES_CHANGING)
        return Refusal(Reason.ARM_MOVED)

    def _waits(self, motion: Motion, longest: float) -> bool:
        """Returns whether a request may wait longer; if so, notes until when [s]."""
        self.due = min(self.due, motion.since + longest)
        return self._moment.now < motion.since + longest

    def _plan(self, motion: Motion, basis: tasks.Basis) -> None:
        """Starts to plan a request from the arm's present state.

        Raises:
            Refusal: the request cannot be carried out, or the time for its planning is over.
        """
        state, wanted, now = self._view.state, motion.wanted, self._moment.now
        assert state is not None
        if motion.basis is not None and motion.planned is not None:
            motion.why = self._stale(motion, basis)
        motion.basis, motion.planned, motion.since = basis, None, now
        if isinstance(wanted, Jog):
            self._plan_jog(motion, wanted, state, basis)
            return
        if (refusal := obstruction(state, *self._locks.mode())) is not None:
            raise refusal
        if wanted.deadline is not None:
            motion.plan_by = now + wanted.deadline if motion.plan_by is None else motion.plan_by
            if now >= motion.plan_by:
                raise motion.why or Refusal(Reason.TOO_LATE_TO_BEGIN)
            wanted = msgspec.structs.replace(wanted, deadline=motion.plan_by - now)
        task = tasks.PlanGoal(wanted, motion.received, self._parts.correction(), basis)
        motion.job = self._parts.jobs.start(task, partial(self._answered, motion))
        if self._waiting:
            self._parts.jobs.hurry(motion.job)

    def _plan_jog(self, motion: Motion, jog: Jog, state: ArmState, basis: tasks.Basis) -> None:
        motion.planned = jog_stages(state, jog.states, self._parts.pace)
        if basis.scene.free or unsure_of(state) is not None:
            self._offer(motion, basis)
            return
        task = tasks.CheckStages(basis.scene, basis.start.commanded, tuple(map(packed, motion.planned)))
        motion.job = self._parts.jobs.start(task, partial(self._answered, motion))

    def _answered(self, motion: Motion, answer: tasks.Answer) -> None:
        """Takes the plan of a goal, or the check of a jog."""
        motion.job = None
        match answer:
            case tasks.Planned():
                motion.planned = answer
            case tasks.Checked(None):
                pass
            case tasks.Checked(str(collision)):
                self._end(motion, Refusal(Reason.START_COLLIDES, collision=collision))
            case _:
                self._end(motion, tasks.refusal_of(answer))

    # --- the program and the answer

    def _offer(self, motion: Motion, basis: tasks.Basis) -> None:
        """Sends the program of a planned request.

        Raises:
            Refusal: the goal is late, or a goal of its id is running.
        """
        planned, wanted, running, state = motion.planned, motion.wanted, self._programs.current, self._view.state
        assert state is not None
        if isinstance(planned, tasks.Planned):
            if running is not None and running.report.id == motion.id:
                raise Refusal(Reason.ALREADY_RUNNING, goal=motion.id)
            program = goal_program(self._parts, motion, planned, state, basis)
        else:
            assert planned is not None
            assert isinstance(wanted, Jog)
            program = jog_program(self._parts, motion, wanted.states, planned, state, basis)
        motion.program, motion.since = program.program.program, self._moment.now
        self._programs.send_program(program)

    def _end(self, motion: Motion, refusal: Refusal) -> None:
        self._drop(motion)
        self._refuse(motion, refusal)

    def _drop(self, motion: Motion) -> None:
        """Removes a request that is answered, or answered elsewhere from now on."""
        self._parts.jobs.abandon(motion.job)
        motion.job = motion.program = None
        if motion is self._current:
            self._current = None
            self._preparation.begin(motion.wanted if isinstance(motion.wanted, GoalMessage) else None)
        else:
            self._waiting.remove(motion)

    def _refuse(self, motion: Motion, refusal: Refusal) -> None:
        """Answers a request; logs at most MOST_LINES refusals a second."""
        self._act(Reply(motion.request, refused(refusal, motion.id)))
        second = int(self._moment.now)
        self._lines, self._second = 1 if second != self._second else self._lines + 1, second
        if self._lines <= MOST_LINES:
            fields = fields_of_refusal(motion.id, refusal.reason.value, refusal.code)
            self._act(Log(logging.INFO, f"{motion.id} refused: {refusal}", fields))
        elif self._lines == MOST_LINES + 1:
            self._act(Log(logging.INFO, f"more than {MOST_LINES} requests are refused in this second"))
