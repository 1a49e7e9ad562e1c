"""Publishes results, exactly one for each program."""

import logging
from collections import deque
from collections.abc import Callable, Sequence

from controller.manipulator.manipulator import Manipulator
from controller.planning.arm_state import Measured
from controller.planning.context import decode_context
from controller.planning.goal_check import Outcome
from controller.planning.messages import Payload
from controller.planning.reports import foreign_result, result
from controller.planning.running_goal import GoalLedger, RunningGoal
from controller.program import Ended, Travel

log = logging.getLogger(__name__)

REMEMBERED = 1_000  # programs whose results the executor may send again

Publish = Callable[[str, Payload], None]


class Results:
    """Publishes results, and records them in the ledger. Not thread-safe.

    Args:
        manipulator: the whole arm.
        ledger: of goals.
        publish: sends a payload on "result", or "inherited" for a goal of an earlier planner process; must not wait.
        ended: takes the sentence on the end of each program.
    """

    def __init__(
        self, manipulator: Manipulator, ledger: GoalLedger, publish: Publish, ended: Callable[[str], None]
    ) -> None:
        self._manipulator, self._ledger, self._publish, self._ended = manipulator, ledger, publish, ended
        self._published: deque[int] = deque(maxlen=REMEMBERED)

    def waive(self, program: int) -> None:
        """Suppresses the result of an abandoned program."""
        self._published.append(program)

    def publish(
        self,
        goal: RunningGoal,
        outcome: Outcome,
        switches: int,
        measured: Measured,
        travels: Sequence[Travel] = (),
    ) -> None:
        """Publishes the result of a program; `travels` are measured travels of actuators."""
        number = goal.program.program
        self._published.append(number)
        payload = result(goal.report.id, outcome, switches, goal.report.where(measured, travels))
        self._publish("result", payload if goal.plan is None else {**payload, **goal.plan.proof()})
        self._ledger.ended(number, outcome.status, outcome.code, outcome.message, switches)
        self._ended(outcome.sentence)

    def publish_inherited(self, message: Ended, measured: Measured) -> None:
        """Publishes the result of a program that an earlier planner process sent, unless it was published before."""
        if message.program in self._published:
            return
        self._published.append(message.program)
        context = decode_context(message.context)
        if context is None:
            log.warning(
                "the result of program %d has no context that this planner can decode: %s",
                message.program,
                message.message,
            )
            return
        payload = foreign_result(self._manipulator, message, measured, context)
        self._publish("inherited", payload)
        status, code, words = payload["status"], payload["code"], payload["message"]
        accepted = context.id, context.sent, context.waypoints
        self._ledger.ended(message.program, status, code, words, message.switches, accepted)
