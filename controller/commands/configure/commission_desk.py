"""Where a person answers a commission: the terminal of this command, and pages."""

from __future__ import annotations

import contextlib
import os
import select
import sys
import time
from collections.abc import Callable, Sequence

from hyperbit.controller.commands.common import console
from hyperbit.controller.commission.questions import OTHERS, Choice, Questions, in_words
from hyperbit.controller.refusals.refusal import Refusal

POLL = 0.1  # [s] between two looks for an answer of a page
AFTER_PAGE = 1.0  # [s] after an answer on a page, for which keys at the terminal do not count
LEAVE = Choice("q", "leave")


class Left(Exception):
    """The person leaves; the arm holds."""


class Withdrawn(Exception):
    """A question has lost its sense, because the state of the arm has changed."""


class Desk:
    """Asks a person. `check` raises an exception if there is nothing left to ask about.

    Args:
        labels: the actuators.
        pages: whether pages are asked, too: then the end of the standard input leaves nothing.
    """

    def __init__(self, labels: Sequence[str], *, pages: bool) -> None:
        self.questions, self._pages, self._ended = Questions(labels), pages, False
        self.check: Callable[[], None] = lambda: None
        self._typed, self._page_at = b"", -AFTER_PAGE

    def begin(self, about: str) -> None:
        console.print(f"\n{about}")
        self.questions.begin(about)

    def say(self, text: str) -> None:
        console.print(f"  {text}")
        self.questions.tell(text)

    def ask(
        self,
        text: str,
        choices: Sequence[Choice],
        *,
        others: bool = False,
        stands: Callable[[], bool] = lambda: True,
    ) -> str:
        """Returns the key of the first answer. Keys that were pressed before the question do not count.

        Raises:
            Left: the answer is `q`, or the terminal is closed.
            Withdrawn: `stands` returned False.
        """
        number = self.questions.ask(text, choices, others=others).number
        typed = False
        try:
            self._drop_typed()
            console.print(f"  {text}: {in_words(choices)}{OTHERS if others else ''}: ", end="")
            while (answer := self.questions.taken()) is None:
                self.check()
                if not stands():
                    console.print("withdrawn")
                    raise Withdrawn
                if (line := self._line()) is not None:
                    typed = self._take(number, line)
        except BaseException:
            self.questions.withdraw()
            raise
        if not typed:
            self._page_at = time.monotonic()
            console.print(f"{answer or 'Enter'} (on a page)")
        if answer == LEAVE.key:
            raise Left
        return answer

    def _take(self, number: int, line: str) -> bool:
        """Returns whether a typed line answers the question."""
        if os.isatty(0) and time.monotonic() < self._page_at + AFTER_PAGE:
            console.print("  not counted: a page has just answered the question before")
        else:
            try:
                self.questions.answer(number, line)
            except Refusal as refusal:
                console.print(f"  {refusal}")
            else:
                return True
        console.print("  answer: ", end="")
        return False

    def _line(self) -> str | None:
        """Returns the next line of the standard input; None if none comes within POLL."""
        if self._ended:
            time.sleep(POLL)
            return None
        if b"\n" not in self._typed:
            if not select.select([0], [], [], POLL)[0]:
                return None
            data = os.read(0, 4096)
            if not data and not self._pages:
                raise Left
            self._ended = not data
            self._typed += data
        line, end, rest = self._typed.partition(b"\n")
        if not end:
            return None
        self._typed = rest
        return line.decode(errors="replace")

    def _drop_typed(self) -> None:
        with contextlib.suppress(ImportError, OSError):
            if os.isatty(0):
                import termios

                termios.tcflush(sys.stdin.fileno(), termios.TCIFLUSH)
                self._typed = b""
