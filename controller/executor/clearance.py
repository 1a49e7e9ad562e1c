"""Questions to the planner: what a stage touches, from states that nobody planned it from."""

from collections.abc import Callable

from controller.program import Clearance, Question, pack

ANSWER_WITHIN = 10.0  # [s] for a planner that is alive but does not answer


class ClearanceQuestions:
    """One question at a time, and its answer.

    Attributes:
        touched: what the stage touches that was asked about last; None if it is clear.
        waits: periods in which the arm held because an answer was missing.

    Args:
        ask: sends a question to the planner.
        actuators: number.
    """

    def __init__(self, ask: Callable[[Question], None], actuators: int) -> None:
        self.touched: str | None = None
        self.waits = 0
        self._ask, self._actuators = ask, actuators
        self._number = 0
        self._way: tuple[int, int] | None = None
        self._asked_at = 0.0
        self._answered = False

    @property
    def waiting(self) -> bool:
        """Whether a question is open."""
        return self._way is not None and not self._answered

    def known(self, start: int, stage: int, now: float) -> bool:
        """Returns whether the answer for a stage from `start` is known, which is then in `touched`; else asks."""
        if (start, stage) != self._way:
            self._number += 1
            self._way, self._answered, self._asked_at = (start, stage), False, now
            self._ask(Question(self._number, pack(start, self._actuators), pack(stage, self._actuators)))
        if not self._answered and now - self._asked_at > ANSWER_WITHIN:
            self.answer(Clearance(self._number, f"nobody knows: no answer within {ANSWER_WITHIN:g} s"))
        return self._answered

    def answer(self, message: Clearance) -> None:
        """Takes the planner's answer, if it is for the last question."""
        if message.question == self._number and self._way is not None:
            self._answered, self.touched = True, message.touched

    def forget(self) -> None:
        """Forgets question and answer."""
        self._way, self._answered = None, False
