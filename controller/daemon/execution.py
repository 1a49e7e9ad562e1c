"""One goal being run: which waypoint is due when. It only reckons; the runner acts."""

from dataclasses import dataclass, field

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
        lead: how long before a waypoint's time its actuators must switch to be settled at it [s].
        waypoint: the one last switched to, -1 before the first.
        settled_at: when that one's actuators are settled; infinite before the first.
        reported: waypoints up to this one have been reported settled, or were left out.
        switches: actuators switched so far.
        plan: the goal's, or a better one that came later.
    """

    goal: Planned
    start: float
    lead: float
    waypoint: int = -1
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

    def due(self, now: float) -> int | None:
        """Returns the waypoint to switch to now, the latest whose time has come: nothing old is made up for."""
        times = self.plan.trajectory.times
        due = int(np.searchsorted(times, now - self.start + self.lead, side="right")) - 1
        return due if due > self.waypoint else None

    def switched(self, waypoint: int, switches: int, now: float, travel: float) -> None:
        """Notes that a waypoint was switched to; it counts as settled at its time, or after the travel."""
        self.waypoint = waypoint
        self.switches += switches
        self.settled_at = max(self.start + float(self.plan.trajectory.times[waypoint]), now + travel)


def start(trajectory: Trajectory, lead: float, monotonic: float, unix: float) -> float:
    """Returns t = 0 of a trajectory on the control loop's clock.

    Without a stamp that is now, or as much later as the first waypoint's actuators need: a waypoint at t = 0 is then
    not skipped, and all keep their distances.
    """
    if trajectory.stamp is None:
        return monotonic + max(lead - float(trajectory.times[0]), 0.0)
    return trajectory.stamp + monotonic - unix
