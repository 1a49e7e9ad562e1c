"""The question of a commission. A terminal and pages may answer it; the first answer counts."""

from __future__ import annotations

import itertools
import secrets
import threading
import time
from collections.abc import Sequence
from typing import Any, NamedTuple

from hyperbit.controller.refusals.reasons import Reason
from hyperbit.controller.refusals.refusal import Refusal

LATEST = 3.0  # [s]; greatest age of the state that the sender of an answer has seen
MOST_LINES = 400  # told lines that a page gets
OTHERS = ", or another actuator and e or c, as 5.left e"


class Choice(NamedTuple):
    """An answer: its key, words for it, and whether a page asks for a long press, as for each motion."""

    key: str
    words: str
    hold: bool = False


class Question(NamedTuple):
    """A question; `others`: an answer may also be another actuator and e or c, as `5.left e`."""

    number: int
    text: str
    choices: tuple[Choice, ...]
    others: bool


class Questions:
    """Has the present question, and what was told before it. Thread-safe.

    Numbers begin at random: an answer to a question of an earlier process fits none of this one.

    Args:
        labels: the actuators.
    """

    def __init__(self, labels: Sequence[str]) -> None:
        self._labels = frozenset(labels)
        self._numbers = itertools.count(secrets.randbelow(2**52))
        self._lock = threading.Lock()
        self._present: Question | None = None
        self._answer: str | None = None  # of the present question
        self._last = (0, b"")  # number of the last answered question, and what identifies the request that answered it
        self._about, self._told = "", list[str]()
        self.changed = threading.Event()  # for who publishes it

    def begin(self, about: str) -> None:
        """Begins what is told about an actuator, or about the end."""
        with self._lock:
            self._about, self._told = about, []
        self.changed.set()

    def tell(self, text: str) -> None:
        with self._lock:
            self._told = [*self._told, *text.splitlines()][-MOST_LINES:]
        self.changed.set()

    def ask(self, text: str, choices: Sequence[Choice], *, others: bool = False) -> Question:
        """Asks a question, in place of the present one."""
        with self._lock:
            self._answer = None
            self._present = Question(next(self._numbers), text, tuple(choices), others)
            self.changed.set()
            return self._present

    def withdraw(self) -> None:
        """Ends the present question; answers to it are refused."""
        with self._lock:
            self._present = self._answer = None
        self.changed.set()

    def taken(self) -> str | None:
        """Returns the answer to the present question, which it ends; None if there is no answer yet."""
        with self._lock:
            answer = self._answer
            if answer is not None:
                self._present = self._answer = None
                self.changed.set()
            return answer

    def answer(self, number: int, text: str, request: bytes = b"") -> None:
        """Answers the question of a number. The same `request` again changes nothing.

        Raises Refusal if the question is not open, or `text` is no answer to it.
        """
        with self._lock:
            if request and self._last == (number, request):
                return
            question = self._present
            if question is None or question.number != number or self._answer is not None:
                why = "it has been answered" if number == self._last[0] else "it is gone"
                raise Refusal(Reason.QUESTION_NOT_OPEN, why=why)
            words = text.split()
            named = question.others and len(words) == 2 and words[0] in self._labels and words[1] in ("e", "c")
            if not named and " ".join(words) not in [choice.key for choice in question.choices]:
                known = in_words(question.choices) + (OTHERS if question.others else "")
                raise Refusal(Reason.NO_ANSWER, given=repr(text[:60]), known=known)
            self._answer, self._last = " ".join(words), (number, request)

    def payload(self) -> dict[str, Any]:
        """Returns the field `commission` of a state."""
        with self._lock:
            it = self._present if self._answer is None else None
            asked = it and {**it._asdict(), "choices": [choice._asdict() for choice in it.choices]}
            return {"about": self._about, "told": self._told, "question": asked}


def in_words(choices: Sequence[Choice]) -> str:
    return ", ".join(f"{choice.key or 'Enter'} {choice.words}" for choice in choices)


def late_answer(stamp: float) -> Refusal | None:
    """Returns why an answer is too late, whose sender saw the state of `stamp` [UNIX s]; None if it is not."""
    age = time.time() - stamp
    return None if abs(age) <= LATEST else Refusal(Reason.ANSWER_TOO_LATE, age=f"{age:.1f}", most=LATEST)
