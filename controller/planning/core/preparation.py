"""The next search is prepared while no request waits, and rehearsed while goals follow each other."""

from __future__ import annotations

import math

from controller.motion.goal import GoalMessage
from controller.planning.core.parts import Parts
from controller.planning.core.tasks import Answer, PrepareSearch

IDLE = 0.02  # [s] without a request before the next search is prepared
REHEARSE_EVERY, REHEARSE_FOR = 0.025, 2.0  # [s] between two rehearsals, and after the last goal


class Preparation:
    """Prepares the next search from where the arm is, once for each start.

    A processor that was idle for a tenth of a second needs twice as long for a search, because its caches are cold. For
    a while after a goal, the goal is therefore planned again and again without effect. The next goal finds warm caches.

    Attributes:
        due: when `advance` must be called again, without another event [s].

    Args:
        parts: of the core.
        prepares: whether the arm's search can be prepared.
    """

    def __init__(self, parts: Parts, prepares: bool) -> None:
        self.due = math.inf
        self._parts, self._prepares = parts, prepares
        self._job: int | None = None
        self._prepared: object = None  # start, scene and tables for which the next search is prepared
        self._last: GoalMessage | None = None
        self._idle_since, self._rehearse_until = 0.0, -math.inf  # [s]

    def end(self) -> None:
        """Frees the worker, because a request has come."""
        self._parts.jobs.abandon(self._job, self._parts.moment.now)
        self._job = self._prepared = None

    def begin(self, planned: GoalMessage | None) -> None:
        """Notes that no request is planned any more; `planned` is a goal that was."""
        now = self._parts.moment.now
        self._idle_since = now
        if planned is not None and len(planned.waypoints) == 1:
            self._last, self._rehearse_until = planned, now + REHEARSE_FOR

    def advance(self) -> None:
        """Prepares or rehearses, if it is time. Call while no request waits."""
        parts, now = self._parts, self._parts.moment.now
        state, scene, tables = parts.view.state, parts.obstacles.scene, parts.locks.tables
        self.due = math.inf
        if not self._prepares or self._job is not None:
            return
        if now < self._idle_since + IDLE:
            self.due = self._idle_since + IDLE
            return
        if state is None or scene is None or tables is None or state.configuration is None or parts.programs.improving:
            return
        start = state.start, scene.generation, tables.generation
        rehearsal = self._last if now < self._rehearse_until and scene.free else None
        if start != self._prepared or rehearsal is not None:
            self._prepared = start
            self._job = parts.jobs.start(PrepareSearch(state.start, tables, scene, rehearsal), self._answered)

    def _answered(self, answer: Answer, last: bool, now: float) -> None:
        self._job = None
        self._idle_since = now + REHEARSE_EVERY - IDLE
