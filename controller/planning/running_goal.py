"""One program, from its sending to its result."""

import threading
from collections.abc import Callable
from typing import Protocol

from controller.motion.plan import Plan
from controller.planning.goal_check import Outcome
from controller.planning.program_feed import ProgramFeed
from controller.planning.reports import Report
from controller.program import Declined, Program


class GoalLedger(Protocol):
    """Records goals and their results; must not wait."""

    def accepted(self, number: int, goal: str, waypoints: int) -> None:
        """Records an accepted goal."""

    def ended(
        self,
        number: int,
        status: str,
        code: int,
        message: str,
        switches: int,
        accepted: tuple[str, float, int] | None = None,
    ) -> None:
        """Records its result; `accepted` as in `Ledger.ended`."""


class RunningGoal:
    """One program, from its sending to its result.

    Attributes:
        program: as it was sent.
        report: makes feedback and result.
        feed: its stages, if they need several messages or may be improved; None for a jog.
        waypoints: number of waypoints.
        begin: its zero of time [s].
        switches: actuators switched so far.
        answered: set when the executor accepted or declined it, or is lost.
        declined: the executor's answer if it declined; None otherwise.
        accepted: whether the executor accepted it.
        plan: the feed's first plan; None for a jog.
        delay: the trajectory's t = 0 in the program's time [s].
        on_accepted: called on acceptance, from the link's thread.
        outcome: the planner's reason to end it; the executor's result follows.
    """

    def __init__(self, program: Program, report: Report, feed: ProgramFeed | None, waypoints: int = 1) -> None:
        self.program, self.report, self.feed, self.waypoints = program, report, feed, waypoints
        self.begin, self.switches = 0.0, 0
        self.answered = threading.Event()
        self.declined: Declined | None = None
        self.accepted = False
        self.outcome: Outcome | None = None
        self.plan: Plan | None = None
        self.delay = 0.0
        self.on_accepted: Callable[[], None] = lambda: None
