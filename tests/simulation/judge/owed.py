"""Results that are owed: what ends a program, and the words that its result must have."""

from __future__ import annotations

from tests.simulation.judge.account import Run

WORDS = {  # of the message of a result, by its cause
    "stop": "stopped",
    "quit": "shutting down",
    "planner": "the planner is",
    "starved": "no further stages",
    "touched": "cannot begin",
    "far": "too far",
    "replaced": "replaced by",
}


class Ending:
    """A program that something ends: its result is owed."""

    def __init__(self, run: Run, at: float) -> None:
        self.run, self.at = run, at
        self.causes: dict[str, str] = {}  # permitted status by cause
        self.words: dict[str, str] = {}  # the message by cause, where it is known
