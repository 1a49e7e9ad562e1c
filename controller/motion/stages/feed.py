"""Feeds a program to the executor: in parts ahead of the motion, only checked stages, with improvements."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from hyperbit.controller.motion.stages.program import pack_states, restage, unpack_states
from hyperbit.controller.program import MOST_BYTES, MOST_STAGES, Replacement, Stage

if TYPE_CHECKING:
    from hyperbit.controller.manipulator.manipulator import Manipulator

PART = 250  # most stages of one message, and least stages ahead of the one that begins
CHECKED_AT_ONCE = 16  # stages of one collision check: the first ones may begin while later ones are checked
OVERHEAD, STAGE_OVERHEAD = 10_000, 48  # bytes of a message without its stages, and of a stage without its states


def most_stages(actuators: int) -> int:
    """Returns the number of stages of an arm with so many actuators that fit into one message."""
    room = (MOST_BYTES - OVERHEAD) // (STAGE_OVERHEAD + (actuators + 7) // 8)
    return max(min(MOST_STAGES, room), 1)


class PlannedPoint(NamedTuple):
    """The stages to one point of a trajectory."""

    point: int  # index in the trajectory; the mark of the last stage
    stages: tuple[bytes, ...]  # packed states after each stage, at least one, with the output bits of locked actuators
    deviation: float | None  # greatest distance of the tip from the straight line; None: not known yet
    switches: int  # number of switches of all stages


class PlanProof(NamedTuple):
    """What is proven of a plan's cost, from its start, with all switches of its stages."""

    switches: int  # number, those of detours included
    cost: float  # weighted number
    bound: float  # proven lower bound of the cost of any plan from this start; 0 if nothing is proven
    certificate: str  # "optimal", "bound" or "unknown"


class Improved(NamedTuple):
    """A better plan: other points from `first` on, the rest as before."""

    first: int  # index of the first changed point
    points: tuple[PlannedPoint, ...]  # all points from `first` on
    proof: PlanProof  # of the whole plan


class Route(NamedTuple):
    """The points of a program and their times."""

    start: bytes  # packed outputs before the first stage
    points: tuple[PlannedPoint, ...]  # with their stages
    times: Sequence[float]  # of the points, in the trajectory's time [s]
    between: Sequence[bool]  # whether each point lies between waypoints; without switches it then needs no stage
    lead: float  # time of one stage [s]
    delay: float  # the trajectory's t = 0 in the program's time [s]
    most: int  # actuators that may switch at once


class Unchecked(NamedTuple):
    """Stages to check for collisions."""

    until: int  # index of the stage after them
    before: bytes  # packed states before the first one
    stages: tuple[bytes, ...]  # packed states after each


@dataclass(eq=False)
class Pending:
    """A replacement that the executor has not answered."""

    sent: int  # number of stages that the executor has if it accepts
    final: bool  # whether these are all stages
    parks: bool = False  # whether it withdraws stages because obstacles have changed
    # points, stages and proof that hold if the executor refuses a better plan
    before: tuple[list[PlannedPoint], list[Stage], list[int], PlanProof | None] | None = None
    better: Improved | None = None  # that plan


class Feed:
    """The stages of a program: those that the executor has, and those to send.

    Only one replacement is unanswered at a time. A better plan replaces stages from the first point not yet begun.
    When obstacles change, `park` withdraws all stages that have not begun. Stages go to the executor again as their
    check finds them clear: no stage begins among obstacles for which it was not checked.

    Attributes:
        begun: index of the latest stage that has begun; -1 before the first.
        strict: whether no stage may be skipped.
        checked: generation of the obstacles for which the stages are, or are being, checked.
        proof: of the plan that is fed; None for a jog, or if it has changed since it was proven.
    """

    def __init__(
        self,
        manipulator: Manipulator,
        program: int,
        route: Route,
        strict: bool,
        checked: int,
        proof: PlanProof | None,
    ) -> None:
        self.begun, self.strict, self.checked, self.proof = -1, strict, checked, proof
        self._manipulator, self._program, self._route = manipulator, program, route
        self._points = list(route.points)
        self._stages = list[Stage]()  # of the first points, as far as they were needed
        self._ends = list[int]()  # number of stages up to each of these points
        self._part = min(PART, most_stages(len(manipulator.actuators)))
        self._generation = 0  # of the last replacement
        self._clear: int | None = None  # number of stages that may be sent; None: all
        self._pending: Pending | None = None
        self._better: Improved | None = None
        self._parks = self._refused = False
        self._extend(self._part)
        self._sent = min(self._part, len(self._stages))
        self._final = self.complete

    # --- what the executor has

    @property
    def first(self) -> tuple[Stage, ...]:
        """The stages of the program's first message."""
        return tuple(self._stages[: self._sent])

    @property
    def complete(self) -> bool:
        """Whether the executor has all stages, as soon as it accepts what was sent."""
        return len(self._ends) == len(self._points) and self._sent == len(self._stages)

    def begin(self, stage: int) -> int:
        """Notes that a stage has begun; returns its point."""
        self.begun, self._refused = max(stage, self.begun), False
        if self._clear is not None:  # a stage that began before the executor heard of the parking
            self._clear = max(self._clear, self.begun + 1)
        return self._points[self._point(self.begun)].point

    def end(self, began: float) -> float:
        """Returns the expected end of the program, in its time [s]; `began`: when its latest stage began."""
        planned = self._route.times[-1] + self._route.delay
        return max(planned, began + self._route.lead * (len(self._stages) - max(self.begun, 0)))

    def deviation(self, mark: int) -> float | None:
        """Returns the planned deviation of the transition to a point; None if it is not known."""
        return self._points[mark].deviation if 0 <= mark < len(self._points) else None

    def note_deviations(self, values: Sequence[float | None]) -> None:
        self._points = [
            point if value is None else point._replace(deviation=value)
            for point, value in zip(self._points, values, strict=True)
        ]

    # --- changes

    def improve(self, better: Improved) -> None:
        """Takes a better plan for the stages that have not begun."""
        if self._better is not None and self._better.first < better.first:  # it was not sent yet: both are one
            kept = self._better.points[: better.first - self._better.first]
            better = Improved(self._better.first, kept + better.points, better.proof)
        self._better, self._refused = better, False

    def park(self, generation: int) -> None:
        """Withdraws all stages that have not begun, because obstacles have changed; makes the program strict."""
        self.checked, self.strict, self._better = generation, True, None
        self._clear = self.begun + 1
        self._parks, self._refused = True, False

    @property
    def waits_for_check(self) -> bool:
        return self._clear is not None

    def to_check(self) -> Unchecked | None:
        """Returns the stages that must be checked next; None if all are clear."""
        if self._clear is None:
            return None
        first = self._clear
        self._extend(first + CHECKED_AT_ONCE)
        if first >= len(self._stages):
            self._clear = None
            return None
        stages = self._stages[first : first + CHECKED_AT_ONCE]
        return Unchecked(first + len(stages), self._before(first), tuple(stage.states for stage in stages))

    def note_clear(self, until: int) -> None:
        """Notes that all stages before the index `until` are clear."""
        if self._clear is not None:
            self._clear = max(self._clear, until)

    # --- messages

    def message(self) -> Replacement | None:
        """Returns the next replacement to send; None if there is none now."""
        if self._pending is not None or self._refused:
            return None
        if self._parks:
            self._parks = False
            if self.begun + 1 < self._sent:
                return self._replacement(self.begun + 1, Pending(self.begun + 1, False, parks=True))
        if self._better is not None:
            better, self._better = self._better, None
            if (message := self._improvement(better)) is not None:
                return message
        if self._sent - 1 - self.begun < self._part and not self._final:
            until, final = self._sendable(self._sent)
            if until > self._sent or final:
                return self._replacement(self._sent, Pending(until, final))
        return None

    def answered(self, generation: int, accepted: bool) -> None:
        """Notes whether the executor accepted a replacement."""
        pending = self._pending
        if pending is None or generation != self._generation:
            return
        self._pending = None
        if accepted:
            self._sent, self._final = pending.sent, pending.final
            return
        if pending.before is not None:
            self._points, self._stages, self._ends, self.proof = pending.before
            self._better = self._better or pending.better
        self._parks = self._parks or pending.parks
        self._refused = True  # nothing is sent until the next stage has begun

    def _sendable(self, first: int) -> tuple[int, bool]:
        """Returns the end of the stages from `first` on that may be sent now, and whether no more will follow."""
        self._extend(first + self._part)
        until = min(len(self._stages), first + self._part)
        until = until if self._clear is None else min(until, self._clear)
        return until, until == len(self._stages) and len(self._ends) == len(self._points)

    def _replacement(self, first: int, pending: Pending) -> Replacement:
        self._generation += 1
        self._pending = pending
        stages = tuple(self._stages[first : pending.sent])
        return Replacement(
            self._program, self._generation, first, self._before(first), stages, pending.final, self.strict
        )

    def _improvement(self, better: Improved) -> Replacement | None:
        """Returns the replacement that a better plan needs: from its first point that has not begun."""
        begun = -1 if self.begun < 0 else self._point(self.begun)
        k = max(better.first, begun + 1)
        late = k - better.first
        if late >= len(better.points):
            return None
        while len(self._ends) < k:
            self._extend(len(self._stages) + 1)
        points, proof = better.points[late:], better.proof
        start = self._ends[k - 1] if k else 0
        if late and self._before(start) != better.points[late - 1].stages[-1]:
            # The plan came too late: the executor has begun the transition to another configuration.
            if self.strict:
                return None
            points = (self._joined(start, points[0]), *points[1:])
        before = self._points, self._stages, self._ends, self.proof
        self._points = [*self._points[:k], *points]
        self._stages, self._ends = self._stages[:start], self._ends[:k]
        self.proof = None if late else proof
        return self._replacement(start, Pending(*self._sendable(start), before=before, better=better))

    def _joined(self, start: int, point: PlannedPoint) -> PlannedPoint:
        """Returns the stages to a point from other states than planned."""
        size = len(self._manipulator.actuators)
        planned = np.array([unpack_states(states, size) for states in point.stages])
        stages = restage(self._manipulator, unpack_states(self._before(start), size), planned, self._route.most)
        return point._replace(stages=tuple(pack_states(stages)), deviation=None)

    # --- the flat list of stages

    def _before(self, stage: int) -> bytes:
        return self._stages[stage - 1].states if stage else self._route.start

    def _point(self, stage: int) -> int:
        return bisect_right(self._ends, stage)

    def _extend(self, count: int) -> None:
        """Appends the stages of further points until there are `count`, or all."""
        route, stages = self._route, self._stages
        while len(stages) < count and len(self._ends) < len(self._points):
            k = len(self._ends)
            states = self._points[k].stages
            if not (k and route.between[k] and len(states) == 1 and states[0] == self._before(len(stages))):
                time, n = route.times[k] + route.delay, len(states)
                earliest = stages[-1].at if stages else -1e12
                for j, packed_states in enumerate(states):
                    at, last = max(time - route.lead * (n - j), earliest), j == n - 1
                    stages.append(Stage(packed_states, at, k if last else -1, time if last else 0.0))
            self._ends.append(len(stages))
