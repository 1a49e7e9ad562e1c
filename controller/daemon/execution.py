"""One goal being run: which stage of which point is due when. It only reckons; the runner acts."""

import math
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from controller.daemon.events import Planned
from controller.motion.plan import Plan
from controller.motion.trajectory import Trajectory


@dataclass(eq=False)
class Execution:
    """A goal's progress on the control loop's clock, so that a change of the wall clock moves nothing.

    Attributes:
        goal: as it was handed over.
        start: t = 0 of its trajectory on the loop's clock.
        lead: time that one stage needs; before a point's time there are that of all its stages [s].
        point: the one last switched to, -1 before the first.
        stage: of the way there, the one last reached, -1 before the first.
        commits: stages that it has taken so far.
        stages: taken since the waypoint before.
        settled_at: when that point's actuators are settled; infinite before its last stage.
        checked: points up to this one have been seen settled, or were left out.
        switches: actuators switched so far.
        plan: the goal's, or a better one that came later.
    """

    goal: Planned
    start: float
    lead: float
    point: int = -1
    stage: int = -1
    commits: int = 0
    stages: int = 0
    settled_at: float = np.inf
    checked: int = -1
    switches: int = 0
    plan: Plan = field(init=False)
    _strayed: float | None = field(init=False, default=0.0)  # on the ways to the points since the waypoint before

    def __post_init__(self) -> None:
        self.plan = self.goal.plan

    @property
    def waypoint(self) -> int:
        """Number of the waypoint last switched to, -1 before the first."""
        return self.plan.trajectory.last(self.point)

    @property
    def last(self) -> bool:
        """Whether the point last switched to is the trajectory's last."""
        return self.point == len(self.plan.trajectory.times) - 1

    @property
    def excursion(self) -> float | None:
        """Greatest since the waypoint before; None if it is not known."""
        transition = self.plan.transitions[self.point]
        own = transition.excursion if self.commits in (0, len(transition.stages)) else None
        return None if own is None or self._strayed is None else max(own, self._strayed)

    def due(self, now: float) -> tuple[int, int] | None:
        """Returns point and stage to switch to now, the latest whose time has come: nothing old is made up for."""
        times, transitions, since = self.plan.trajectory.times, self.plan.transitions, now - self.start
        point = int(np.searchsorted(times, since + self.lead, side="right")) - 1
        stage = len(transitions[point].stages) - 1
        if point < len(times) - 1:  # there is time for one transition only between two points
            left = float(times[point + 1]) - since
            following = math.floor(len(transitions[point + 1].stages) - left / self.lead + 1e-9)
            if following >= 0:
                point, stage = point + 1, following
        if point < 0 or (point, stage) <= (self.point, self.stage) or self._holds(point):
            return None
        return point, stage

    def onward(self, point: int, stage: int) -> list[tuple[int, int]]:
        """Returns the points and stages after the one last reached up to another."""
        since, transitions = (self.point, self.stage), self.plan.transitions
        stages = [(p, s) for p in range(max(self.point, 0), point + 1) for s in range(len(transitions[p].stages))]
        return [at for at in stages if since < at <= (point, stage)]

    @property
    def left(self) -> list[NDArray[np.uint8]]:
        """Actuator states (A,) that each of the stages ends in that are not reached yet."""
        transitions = self.plan.transitions
        end = len(transitions) - 1, len(transitions[-1].stages) - 1
        return [transitions[p].stages[s] for p, s in self.onward(*end)]

    def _holds(self, point: int) -> bool:
        """Returns whether nothing is to be done for a point, between waypoints and with the states there are."""
        transitions, reached = self.plan.transitions, self.settled_at < np.inf
        same = reached and np.array_equal(transitions[point].stages[-1], transitions[self.point].stages[-1])
        return same and self.plan.trajectory.between(point)

    def switched(self, point: int, stage: int, switches: int, commits: int, now: float, travel: float) -> None:
        """Notes what was switched, by how many commits, and the stage reached, -1 for none yet.

        A point counts as settled at its time, or after the travel of its last stage.
        """
        trajectory = self.plan.trajectory
        if point != self.point:
            self._strayed = self.excursion if self.point >= 0 else 0.0
            if self.point < 0 or trajectory.next(point) != trajectory.next(self.point):
                self.stages, self._strayed = 0, 0.0
            self.commits = 0
        self.point, self.stage = point, stage
        self.commits += commits
        self.stages += commits
        self.switches += switches
        last = stage == len(self.plan.transitions[point].stages) - 1
        settled = max(self.start + float(trajectory.times[point]), now + travel)
        self.settled_at = settled if last else np.inf

    def improve(self, plan: Plan) -> None:
        """Takes a better plan for what is not begun."""
        begun = max(self.point, 0) + 1  # the first may have been staged anew
        transitions = self.plan.transitions[:begun] + plan.transitions[begun:]
        self.plan = replace(plan, transitions=transitions)


def start(trajectory: Trajectory, lead: float, monotonic: float, unix: float) -> float:
    """Returns t = 0 of a trajectory on the control loop's clock.

    Without a stamp that is now, or as much later as the first waypoint's actuators need: a waypoint at t = 0 is then
    not skipped, and all keep their distances.
    """
    if trajectory.stamp is None:
        return monotonic + max(lead - float(trajectory.times[0]), 0.0)
    return trajectory.stamp + monotonic - unix
