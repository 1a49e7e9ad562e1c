"""One program from the moment that it is sent until its result."""

import threading
from collections.abc import Callable
from typing import Protocol

from controller.motion.plan import Plan
from controller.planning.goal_check import Verdict
from controller.planning.program_feed import ProgramFeed
from controller.planning.reports import Report
from controller.program import Declined, Program


class GoalLedger(Protocol):
    """Where goals and their results are entered; must not wait."""

    def accepted(self, number: int, goal: str, waypoints: int) -> None:
        """Enters a goal that is run."""

    def ended(
        self,
        number: int,
        status: str,
        code: int,
        message: str,
        switches: int,
        accepted: tuple[str, float, int] | None = None,
    ) -> None:
        """Enters its result; `accepted` as in `Ledger.ended`."""


class RunningGoal:
    """A program from the moment that it is sent until its result.

    Attributes:
        program: as it was sent.
        report: what is told of it.
        feed: its stages, where they are more than one message or may be improved; None for a jog.
        waypoints: how many it has.
        begin: its zero of time [s].
        switches: actuators switched so far.
        answered: set when the executor took or declined it, or is gone.
        declined: why it was declined; None: it was taken, or the executor is gone.
        accepted: whether it was taken.
        plan: that the feed began with; None for a jog.
        delay: the trajectory's t = 0 in the program's time [s].
        on_accepted: called when it was taken, from the link's thread.
        verdict: that ends it, as the planner found; the executor's result follows.
    """

    def __init__(self, program: Program, report: Report, feed: ProgramFeed | None, waypoints: int = 1) -> None:
        self.program, self.report, self.feed, self.waypoints = program, report, feed, waypoints
        self.begin, self.switches = 0.0, 0
        self.answered = threading.Event()
        self.declined: Declined | None = None
        self.accepted = False
        self.verdict: Verdict | None = None
        self.plan: Plan | None = None
        self.delay = 0.0
        self.on_accepted: Callable[[], None] = lambda: None
