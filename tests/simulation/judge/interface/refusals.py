"""Refusals: the page's code and sentence for each reason; `grounds.py` has what must hold for each reason."""

from __future__ import annotations

import re
from pathlib import Path

from tests.simulation.judge.interface.account import InterfaceAccount
from tests.simulation.judge.interface.facts import Payload, Request
from tests.simulation.judge.interface.grounds import GROUNDS
from tests.simulation.judge.verdict import require

PAGE = Path(__file__).parents[4] / "controller" / "refusals" / "README.md"


def reasons_on_the_page() -> dict[str, tuple[int, re.Pattern[str]]]:
    """Returns code and sentence of each reason in the page's table; facts in the sentence match anything."""
    found = {}
    for row in PAGE.read_text().splitlines():
        if match := re.match(r"\| `([a-z0-9-]+)` \| (-?\d+) \| (.*?) \| ", row):
            words = re.sub(r"\\\{[^}]*\\\}", ".*", re.escape(match[3]))
            found[match[1]] = int(match[2]), re.compile(words, re.DOTALL)
    return found


REASONS = reasons_on_the_page()


def judge_refusal(a: InterfaceAccount, request: Request, answer: Payload) -> None:
    """Judges code, sentence and ground of a refusal."""
    reason, words = str(answer.get("reason")), f"{request} is refused: {answer}"
    require(reason in REASONS, f"{words}; the page has no such reason")
    code, sentence = REASONS[reason]
    require(answer["code"] == code, f"{words}; the page has code {code}")
    require(sentence.fullmatch(answer["message"]) is not None, f"{words}; the page has another sentence")
    holds = GROUNDS.get(reason)
    require(holds is not None, f"{words}; the judge knows no condition for it")
    assert holds is not None
    require(holds(a, request), f"{words}; but that does not hold")
