"""Results on their way out: each program is told exactly one."""

import logging
from collections import deque
from collections.abc import Callable, Sequence

from controller.manipulator.manipulator import Manipulator
from controller.planning.arm_state import Measured
from controller.planning.context import decode_context
from controller.planning.goal_check import Verdict
from controller.planning.messages import Payload
from controller.planning.reports import foreign_result, result
from controller.planning.running_goal import GoalLedger, RunningGoal
from controller.program import Ended, Travel

log = logging.getLogger(__name__)

REMEMBERED = 1_000  # programs, of which the executor may send the result again

Publish = Callable[[str, Payload], None]


class Results:
    """Publishes results, and enters them in the ledger. One thread's at a time.

    Args:
        manipulator: the whole arm.
        ledger: of goals.
        publish: sends a payload on "result", or "inherited" for the result of another run's goal; must not wait.
        ended: told the sentence on the end of each program.
    """

    def __init__(
        self, manipulator: Manipulator, ledger: GoalLedger, publish: Publish, ended: Callable[[str], None]
    ) -> None:
        self._manipulator, self._ledger, self._publish, self._ended = manipulator, ledger, publish, ended
        self._told: deque[int] = deque(maxlen=REMEMBERED)

    def waive(self, program: int) -> None:
        """Has no result published of a program that was given up."""
        self._told.append(program)

    def tell(
        self,
        goal: RunningGoal,
        verdict: Verdict,
        switches: int,
        measured: Measured,
        travels: Sequence[Travel] = (),
    ) -> None:
        """Publishes the result of a program; `travels` are measured ways of actuators."""
        number = goal.program.program
        self._told.append(number)
        told = result(goal.report.id, verdict, switches, goal.report.where(measured, travels))
        self._publish("result", told if goal.plan is None else {**told, **goal.plan.proof()})
        self._ledger.ended(number, verdict.status, verdict.code, verdict.message, switches)
        self._ended(verdict.sentence)

    def foreign(self, message: Ended, measured: Measured) -> None:
        """Publishes the result of a program that another run of the planner sent, unless it was told before."""
        if message.program in self._told:
            return
        self._told.append(message.program)
        context = decode_context(message.context)
        if context is None:
            log.warning("the result of program %d is not for this planner: %s", message.program, message.message)
            return
        payload = foreign_result(self._manipulator, message, measured, context)
        self._publish("inherited", payload)
        status, code, words = payload["status"], payload["code"], payload["message"]
        accepted = context.id, context.sent, context.waypoints
        self._ledger.ended(message.program, status, code, words, message.switches, accepted)
