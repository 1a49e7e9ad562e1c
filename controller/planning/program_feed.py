"""Feeds a program to the executor: in parts ahead of the motion, with improvements of stages that have not begun."""

from bisect import bisect_left, bisect_right
from dataclasses import dataclass
from itertools import accumulate

import numpy as np

from controller.manipulator.manipulator import Manipulator
from controller.motion.pacing import Pace, Staged
from controller.motion.plan import Plan
from controller.motion.program import Pack, PointStages, flatten, point_stages, stages_from, unpack_states
from controller.motion.restaging import restage
from controller.program import MOST_BYTES, MOST_STAGES, Replacement, Stage

PART = 250  # most stages of one message, and least stages ahead of the one that begins
OVERHEAD, STAGE_OVERHEAD = 10_000, 48  # bytes of a message without its stages, and of a stage without its states


def most_stages(actuators: int) -> int:
    """Returns the number of stages of an arm with so many actuators that fit into one message."""
    room = (MOST_BYTES - OVERHEAD) // (STAGE_OVERHEAD + (actuators + 7) // 8)
    return max(min(MOST_STAGES, room), 1)


@dataclass(frozen=True, eq=False)
class Part:
    """Points that go to the executor in one message.

    Attributes:
        start: index of the first point in the program; earlier points stay.
        points: with their stages.
        following: the plan's point with which the next part begins.
        plan: of the points.
        strict: whether the program is strict from this message on.
    """

    start: int
    points: list[PointStages]
    following: int
    plan: Plan
    strict: bool


class ProgramFeed:
    """The stages of a program: those that the executor has, and those to send. Not thread-safe.

    Only one replacement is unanswered at a time. A better plan replaces stages from the first point not yet begun.

    Attributes:
        generation: of the last replacement.
        strict: whether no stage may be skipped.

    Args:
        manipulator: the whole arm.
        plan: the first plan.
        pace: of the transitions.
        delay: the trajectory's t = 0 in the program's time [s].
        pack: packs actuator states.
        program: its number.
        strict: whether no stage may be skipped.
    """

    def __init__(
        self, manipulator: Manipulator, plan: Plan, pace: Pace, delay: float, pack: Pack, program: int, strict: bool
    ) -> None:
        self.generation, self.strict = 0, strict
        self._manipulator, self._plan, self._pace, self._delay, self._pack = manipulator, plan, pace, delay, pack
        self._program = program
        self._most = min(PART, most_stages(len(manipulator.actuators)))
        self._points, self._ends = list[PointStages](), list[int]()  # sent points, stages up to each
        self._begun = -1  # index of the latest stage that has begun
        self._pending: Part | None = None
        self._better: Plan | None = None
        self._make_strict = False
        self._refused = False  # if so, nothing is sent until the next stage has begun
        self._next = 0
        self._append(self._part(0, plan, 0, None, -np.inf))

    @property
    def stages(self) -> tuple[Stage, ...]:
        """The stages that the executor has."""
        return tuple(flatten(self._points))

    @property
    def final(self) -> bool:
        """Whether the executor has all stages."""
        return self._next == len(self._plan.transitions)

    def begin(self, stage: int) -> int:
        """Notes that a stage has begun; returns its point."""
        self._begun, self._refused = max(stage, self._begun), False
        return self._points[self._index(self._begun)].point

    def deviation(self, point: int) -> float | None:
        """Returns the planned deviation of the transition to a point; None if it is not known."""
        index = bisect_left(self._points, point, key=lambda reached: reached.point)
        found = self._points[index : index + 1]
        return found[0].deviation if found and found[0].point == point else None

    def remaining(self) -> list[Stage]:
        """Returns the stages that have not begun, including those not sent yet."""
        last = self._points[-1]
        ahead = stages_from(
            self._plan, self._next, last.end, self._pace.lead, self._delay, last.stages[-1].at, self._pack
        )
        return flatten(self._points)[self._begun + 1 :] + flatten(list(ahead))

    def improve(self, plan: Plan) -> None:
        """Takes a better plan for the stages that have not begun."""
        self._better, self._refused = plan, False

    def make_strict(self) -> None:
        """Makes the program strict from now on, because obstacles were sent."""
        self._make_strict, self.strict = self._make_strict or not self.strict, True

    def message(self) -> Replacement | None:
        """Returns the next replacement to send; None if there is none now."""
        if self._pending is not None or self._refused:
            return None
        if self._better is not None:
            plan, self._better = self._better, None
            if (message := self._improvement(plan)) is not None:
                return message
        if self._make_strict or (not self.final and self._ends[-1] - 1 - self._begun < self._most):
            last = self._points[-1]
            start, at = len(self._points), last.stages[-1].at
            return self._replacement(self._part(start, self._plan, self._next, last.end, at))
        return None

    def answered(self, generation: int, accepted: bool) -> None:
        """Notes whether the executor accepted a replacement."""
        if self._pending is None or generation != self.generation:
            return
        part, self._pending = self._pending, None
        if accepted:
            self._append(part)
            self._make_strict = self._make_strict and not part.strict
            return
        self._refused = True
        if part.plan is not self._plan and self._better is None:
            self._better = part.plan

    def _improvement(self, plan: Plan) -> Replacement | None:
        """Returns the replacement that a better plan needs: from the first point that differs and has not begun."""
        begun = self._index(self._begun)
        first, old, new = self._points[begun].point + 1, self._plan.transitions, plan.transitions
        while first < len(new) and new[first] is old[first]:
            first += 1
        if first >= len(new):
            return None
        start = max(bisect_left(self._points, first, key=lambda reached: reached.point), begun + 1)
        before = self._points[start - 1]
        end, at = before.end, before.stages[-1].at
        transition = new[first]
        if self._pack(new[first - 1].stages[-1:])[0] != end:
            # The plan came too late: the executor has begun the transition to another configuration.
            if self.strict:
                return None
            transition = self._from(end, transition)
        joined = point_stages(plan.trajectory, first, transition, self._pace.lead, self._delay, at, self._pack)
        if joined.end == end and plan.trajectory.between(first):
            return self._replacement(self._part(start, plan, first + 1, end, at))
        return self._replacement(self._part(start, plan, first + 1, joined.end, joined.stages[-1].at, joined))

    def _from(self, end: bytes, transition: Staged) -> Staged:
        """Returns a transition from other states than planned."""
        actuators = len(self._manipulator.actuators)
        states = restage(
            self._manipulator, unpack_states(end, actuators), transition.stages, self._pace.inrush or actuators
        )
        return Staged(states, None)

    def _replacement(self, part: Part) -> Replacement:
        self.generation += 1
        self._pending = part
        return Replacement(
            self._program,
            self.generation,
            self._ends[part.start - 1],
            self._points[part.start - 1].end,
            tuple(flatten(part.points)),
            part.following == len(part.plan.transitions),
            part.strict,
        )

    def _part(
        self,
        start: int,
        plan: Plan,
        first: int,
        end: bytes | None,
        not_before: float,
        joined: PointStages | None = None,
    ) -> Part:
        """Returns a part of a plan's points from `first` on: as many as fit into one message, at least one."""
        taken = [] if joined is None else [joined]
        count, following = len(flatten(taken)), len(plan.transitions)
        for reached in stages_from(plan, first, end, self._pace.lead, self._delay, not_before, self._pack):
            count += len(reached.stages)
            if taken and count > self._most:
                following = reached.point
                break
            taken.append(reached)
        return Part(start, taken, following, plan, self.strict)

    def _append(self, part: Part) -> None:
        """Appends a part that the executor has accepted."""
        del self._points[part.start :], self._ends[part.start :]
        before = self._ends[-1] if self._ends else 0
        ends = accumulate((len(reached.stages) for reached in part.points), initial=before)
        self._points += part.points
        self._ends += list(ends)[1:]
        self._next, self._plan = part.following, part.plan

    def _index(self, stage: int) -> int:
        """Returns the index of a stage's point; of the first point before any stage has begun."""
        return min(bisect_right(self._ends, max(stage, 0)), len(self._ends) - 1)
