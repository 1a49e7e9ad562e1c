"""One goal being run: which stage of which waypoint is due when. It only reckons; the runner acts."""

import math
from dataclasses import dataclass, field, replace

import numpy as np

from controller.daemon.events import Planned
from controller.motion.goal import Trajectory
from controller.motion.plan import Plan


@dataclass(eq=False)
class Execution:
    """A goal's progress on the control loop's clock, so that a change of the wall clock moves nothing.

    Attributes:
        goal: as it was handed over.
        start: t = 0 of its trajectory on the loop's clock.
        lead: time that one stage needs; before a waypoint's time there are that of all its stages [s].
        waypoint: the one last switched to, -1 before the first.
        stage: of the way there, the one last reached, -1 before the first.
        commits: stages that it has taken so far.
        settled_at: when that waypoint's actuators are settled; infinite before its last stage.
        reported: waypoints up to this one have been reported settled, or were left out.
        switches: actuators switched so far.
        plan: the goal's, or a better one that came later.
    """

    goal: Planned
    start: float
    lead: float
    waypoint: int = -1
    stage: int = -1
    commits: int = 0
    settled_at: float = np.inf
    reported: int = -1
    switches: int = 0
    plan: Plan = field(init=False)

    def __post_init__(self) -> None:
        self.plan = self.goal.plan

    @property
    def last(self) -> bool:
        """Whether the waypoint last switched to is the trajectory's last."""
        return self.waypoint == len(self.plan.trajectory.times) - 1

    @property
    def excursion(self) -> float | None:
        """Of the transition to the waypoint last switched to; None if it is not known."""
        transition = self.plan.transitions[self.waypoint]
        return transition.excursion if self.commits in (0, len(transition.stages)) else None

    def due(self, now: float) -> tuple[int, int] | None:
        """Returns waypoint and stage to switch to now, the latest whose time has come: nothing old is made up for."""
        times, transitions, since = self.plan.trajectory.times, self.plan.transitions, now - self.start
        waypoint = int(np.searchsorted(times, since + self.lead, side="right")) - 1
        stage = len(transitions[waypoint].stages) - 1
        if waypoint < len(times) - 1:  # there is time for one transition only between two waypoints
            left = float(times[waypoint + 1]) - since
            following = math.floor(len(transitions[waypoint + 1].stages) - left / self.lead + 1e-9)
            if following >= 0:
                waypoint, stage = waypoint + 1, following
        return (waypoint, stage) if waypoint >= 0 and (waypoint, stage) > (self.waypoint, self.stage) else None

    def switched(self, waypoint: int, stage: int, switches: int, now: float, travel: float) -> None:
        """Notes what was switched, and the stage reached, -1 for none yet.

        A waypoint counts as settled at its time, or after the travel of its last stage.
        """
        if waypoint != self.waypoint:
            self.commits = 0
        self.waypoint, self.stage = waypoint, stage
        self.commits += switches > 0
        self.switches += switches
        last = stage == len(self.plan.transitions[waypoint].stages) - 1
        settled = max(self.start + float(self.plan.trajectory.times[waypoint]), now + travel)
        self.settled_at = settled if last else np.inf

    def improve(self, plan: Plan) -> None:
        """Takes a better plan for what is not begun."""
        begun = max(self.waypoint, 0) + 1  # the first may have been staged anew
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
