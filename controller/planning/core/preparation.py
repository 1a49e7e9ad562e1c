"""Prepares the next search while no request for motion waits."""

import math

from hyperbit.controller.motion.decoding.goal import GoalMessage
from hyperbit.controller.planning.core import tasks
from hyperbit.controller.planning.core.parts import Parts
from hyperbit.controller.planning.core.premises import Premises
from hyperbit.controller.planning.core.programs import Programs

IDLE = 0.02  # [s] without a request before the next search is prepared
REHEARSE_EVERY, REHEARSE_FOR = 0.025, 2.0  # [s] between two rehearsals, and after the last goal


class Preparation:
    """Prepares the next search from where the arm is, once for each start.

    A processor that was idle for a tenth of a second needs twice as long for a search, because its caches are cold. For
    a while after a goal, the goal is therefore planned again and again without effect. The next goal finds warm caches.
    """

    def __init__(self, parts: Parts, premises: Premises, programs: Programs, prepares: bool) -> None:
        self._parts, self._premises, self._programs, self._prepares = parts, premises, programs, prepares
        self._job: int | None = None
        self._prepared: tasks.Basis | None = None  # for which the next search is prepared
        self._last: GoalMessage | None = None
        self._idle_since, self._rehearse_until = 0.0, -math.inf  # [s]

    def end(self) -> None:
        """Frees the worker, because a request has come."""
        self._parts.jobs.abandon(self._job)
        self._job = self._prepared = None

    def begin(self, planned: GoalMessage | None) -> None:
        """Notes that no request is planned any more; `planned` is a goal that was."""
        self._idle_since = now = self._parts.moment.now
        if planned is not None and len(planned.waypoints) == 1:
            self._last, self._rehearse_until = planned, now + REHEARSE_FOR

    def advance(self) -> float:
        """Prepares or rehearses, if it is time; returns when to call again while no request waits [s]."""
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
