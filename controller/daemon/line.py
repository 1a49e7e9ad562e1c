"""Goals that wait to begin: one of which it is not known yet whether it may, and those that came after it."""

from collections import deque
from collections.abc import Callable
from dataclasses import replace

from controller.daemon.avoidance import Unknown
from controller.daemon.events import Improved, Planned
from controller.daemon.messages import refused
from controller.motion import codes


class Line:
    """Goals in the order in which they came. The control loop's."""

    def __init__(self) -> None:
        self._goals: deque[Planned] = deque()

    def __len__(self) -> int:
        """Returns how many wait."""
        return len(self._goals)

    def add(self, goal: Planned) -> None:
        """Has a goal wait behind the others."""
        self._goals.append(goal)

    def improve(self, better: Improved) -> None:
        """Takes a better plan for the goal that it is for, if that waits."""
        for k, goal in enumerate(self._goals):
            if goal.arrival == better.arrival and goal.kept is better.kept:
                self._goals[k] = replace(goal, plan=better.plan)

    def take(self, begin: Callable[[Planned], None]) -> None:
        """Has goals begun, or refused, up to one of which `begin` raises Unknown."""
        while self._goals:
            goal = self._goals.popleft()
            try:
                begin(goal)
            except Unknown:
                self._goals.appendleft(goal)
                return

    def close(self) -> None:
        """Refuses all."""
        while self._goals:
            goal = self._goals.popleft()
            goal.reply(refused(codes.INVALID_GOAL, "the daemon is shutting down; the arm holds", goal.id))
