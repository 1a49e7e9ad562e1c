"""How long a search may take."""

import math
from typing import NamedTuple

from hyperbit.controller.search.clock import EFFORT, Clock, WorkClock

TIMEOUT = 0.05  # [s] for one search
UNFOUND = 1.0  # [s] for a goal that is not reached in the first time, without a deadline or if others wait

# Configurations of an arm that is listed whole, at most. The list takes about 20 ms, once; a goal below 1 ms, and up to
# 20 ms if nearly all configurations collide.
LISTED_WHOLE = 1 << 14
# Time [s] for each point of a trajectory, each configuration and each state of a module. If the sum fits into the time
# of a search, all sequences of an arm that is listed whole are tried.
TRIED = 8e-9


class SearchTime(NamedTuple):
    """How long one minimum-switch search may take, from its start [s]. A proof ends it sooner."""

    first: float  # time in any case, except for `most`
    per_switch: float = 0.0  # further time for each switch that, by the lower bound, may still be saved
    unfound: float = 0.0  # time as long as no configuration within the tolerances is found
    most: float = math.inf  # the deadline
    by_work: bool = False  # whether all times are work, see WorkClock

    def clock(self, wall: Clock) -> Clock:
        return WorkClock() if self.by_work else wall

    def allowed(self, gap: float) -> float:
        """Returns the time of a search [s] for the number of switches that may still be saved.

        The gap is infinite if no configuration is found.
        """
        found = self.first + gap * self.per_switch if gap < math.inf else max(self.first, self.unfound)
        return min(found, self.most)


def search_time(first: float, per_switch: float = 0.0, deadline: float | None = None) -> SearchTime:
    """Returns the time of a search that goes on until a deadline as long as nothing is found; None: until UNFOUND."""
    if deadline is None:
        return SearchTime(first, per_switch, UNFOUND)
    return SearchTime(first, per_switch, deadline, deadline)


def search_effort(effort: float, missed: float | None = None) -> SearchTime:
    """Returns the work of a search that goes on until `missed` as long as nothing is found; None: that of UNFOUND.

    One unit of `effort` and `missed` takes about EFFORT seconds on an ordinary computer.
    """
    first, most = effort * EFFORT, None if missed is None else max(effort, missed) * EFFORT
    return search_time(first, deadline=most)._replace(by_work=True)
