"""Results of programs, stored until the planner acknowledges them."""

from collections.abc import Callable

from hyperbit.controller.executor.arm.switch_journal import SwitchJournal
from hyperbit.controller.executor.motion.program_execution import ProgramExecution
from hyperbit.controller.program import MOST_TRAVELS, Counted, Ended, Up

MOST_STORED = 1_000


class ProgramResults:
    """Sends the results of programs, and stores them until the planner acknowledges them.

    Args:
        send: sends a message to the planner, if there is one.
        journal: counts switches.
    """

    def __init__(self, send: Callable[[Up], None], journal: SwitchJournal) -> None:
        self._send, self._journal = send, journal
        self._number = 0
        self._stored: dict[int, Ended] = {}

    def add(self, execution: ProgramExecution, status: str, message: str, measured: bytes, known: bytes) -> None:
        """Sends the single result of a program after the counts, and stores it."""
        self._number += 1
        program = execution.program
        result = Ended(
            result=self._number,
            program=program.program,
            context=program.context,
            status=status,  # type: ignore[arg-type]
            message=message[:1_000],
            mark=execution.mark,
            switches=execution.switches,
            measured=measured,
            known=known,
            travels=tuple(execution.travels[:MOST_TRAVELS]),
            verified=execution.verified,
        )
        self._stored[self._number] = result
        if len(self._stored) > MOST_STORED:  # the planner acknowledges nothing
            del self._stored[min(self._stored)]
        self.send_counts()
        self._send(result)

    def acknowledge(self, number: int) -> None:
        """Removes a result."""
        self._stored.pop(number, None)

    def send_counts(self) -> None:
        """Sends the number of switches of each actuator."""
        self._send(Counted(tuple(self._journal.counts)))

    def send_again(self) -> None:
        """Sends all stored results to a planner that has just connected."""
        for result in self._stored.values():
            self._send(result)
