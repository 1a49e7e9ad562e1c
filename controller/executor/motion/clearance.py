"""Questions to the planner: does a stage touch an obstacle, if it begins from states that were not planned?"""

from collections.abc import Callable

from hyperbit.controller.program import Clearance, Question, pack

ANSWER_WITHIN = 10.0  # [s]; without an answer the stage counts as not clear


class ClearanceQuestions:
    """One question at a time, and its answer.

    Attributes:
        touched: what the stage of the last question touches, in words; None if the stage is clear.
        waits: number of periods in which the arm waited for an answer.

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

    def ask(self, start: int, stage: int, now: float) -> bool:
        """Asks the planner about `stage` from `start`, once; returns whether the answer is there, in `touched`."""
        if (start, stage) != self._way:
            self._number += 1
            self._way, self._answered, self._asked_at = (start, stage), False, now
            self._ask(Question(self._number, pack(start, self._actuators), pack(stage, self._actuators)))
        if not self._answered and now - self._asked_at > ANSWER_WITHIN:
            unknown = f"the planner did not tell within {ANSWER_WITHIN:g} s whether the stage is clear"
            self.receive_answer(Clearance(self._number, unknown))
        return self._answered

    def receive_answer(self, message: Clearance) -> None:
        """Takes the planner's answer; ignores an answer to an earlier question."""
        if message.question == self._number and self._way is not None:
            self._answered, self.touched = True, message.touched

    def forget(self) -> None:
        """Forgets question and answer."""
        self._way, self._answered = None, False
