"""One goal being run: which waypoint is due when. It only reckons; the control loop acts."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from controller.daemon.events import Planned
from controller.motion.plan import Plan
from controller.search.solver import Solution


@dataclass(eq=False)
class Execution:
    """A goal's progress on the control loop's clock, so that a change of the wall clock moves nothing.

    Attributes:
        goal: as it was handed over.
        offset: monotonic minus UNIX seconds when the goal was taken.
        lead: how long before a waypoint's time its actuators must switch to be settled at it [s].
        waypoint: the one last switched to, -1 before the first.
        settled_at: when that one's actuators are settled; infinite before the first.
        reported: waypoints up to this one have been reported settled.
        switches: actuators switched so far.
    """

    goal: Planned
    offset: float
    lead: float
    waypoint: int = -1
    settled_at: float = np.inf
    reported: int = -1
    switches: int = 0
    _times: NDArray[np.float64] = field(init=False)

    def __post_init__(self) -> None:
        self._times = self.plan.trajectory.times + self.offset

    @property
    def plan(self) -> Plan:
        """The goal's plan."""
        return self.goal.plan

    @property
    def current(self) -> Solution:
        """The solution of the waypoint last switched to."""
        return self.plan.solutions[self.waypoint]

    def next_switch(self) -> float:
        """Returns when the next waypoint's actuators are to switch; infinite after the last."""
        following = self.waypoint + 1
        return float(self._times[following] - self.lead) if following < len(self._times) else np.inf

    def due(self, now: float) -> int | None:
        """Returns the waypoint to switch to now, the latest whose time has come: nothing old is made up for."""
        due = int(np.searchsorted(self._times - self.lead, now, side="right")) - 1
        return due if due > self.waypoint else None

    def switched(self, waypoint: int, switches: int, now: float, travel: float) -> None:
        """Notes that a waypoint was switched to; it counts as settled at its time, or after the travel."""
        self.waypoint = waypoint
        self.switches += switches
        self.settled_at = max(float(self._times[waypoint]), now + travel)

    @property
    def last(self) -> bool:
        """Whether the waypoint last switched to is the trajectory's last."""
        return self.waypoint == len(self._times) - 1
