"""Results of programs, kept until the planner has acknowledged them."""

from collections.abc import Callable

from controller.executor.program_execution import ProgramExecution
from controller.executor.switch_journal import SwitchJournal
from controller.program import MOST_TRAVELS, Counted, Ended, Up

MOST_KEPT = 1_000


class Results:
    """The results that no planner has acknowledged yet.

    Args:
        send: sends a message to the planner, if there is one.
        journal: counts switches.
    """

    def __init__(self, send: Callable[[Up], None], journal: SwitchJournal) -> None:
        self._send, self._journal = send, journal
        self._number = 0
        self._kept: dict[int, Ended] = {}

    def add(self, execution: ProgramExecution, status: str, message: str, measured: bytes, known: bytes) -> None:
        """Sends the one result of a program, after the counts, and keeps it."""
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
        )
        self._kept[self._number] = result
        if len(self._kept) > MOST_KEPT:  # a planner that acknowledges nothing
            del self._kept[min(self._kept)]
        self.send_counts()
        self._send(result)

    def acknowledge(self, number: int) -> None:
        """Forgets a result."""
        self._kept.pop(number, None)

    def send_counts(self) -> None:
        """Sends how often each actuator has switched."""
        self._send(Counted(tuple(self._journal.counts)))

    def send_again(self) -> None:
        """Sends all to a planner that has just connected."""
        for result in self._kept.values():
            self._send(result)
