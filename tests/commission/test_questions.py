"""Of all answers to a question the first counts, whoever gives it, and however often."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hyperbit.controller.commission.questions import Choice, Questions
from hyperbit.controller.refusals.refusal import Refusal

WORDS = st.sampled_from(["e", "c", "1.2 e", " 1.2  c ", "1.9 e", "1.2 x", "", "x", "1.2 e c"])
GIVEN = st.tuples(st.integers(-1, 1), WORDS, st.sampled_from([b"", b"a", b"b"]))


@given(st.lists(GIVEN, max_size=8))
def test_the_first_answer_to_the_present_question_counts(given: list[tuple[int, str, bytes]]) -> None:
    it = Questions(["1.1", "1.2"])
    number = it.ask("what was seen", (Choice("e", "extended"), Choice("c", "contracted")), others=True).number
    first: tuple[str, bytes] | None = None
    for step, words, request in given:
        clean = " ".join(words.split())
        fits = step == 0 and clean in ("e", "c", "1.2 e", "1.2 c")
        if fits and first is None:
            it.answer(number, words, request)
            first = clean, request
        elif step == 0 and first is not None and request and request == first[1]:
            it.answer(number, words, request)  # the same request again: it is told the same
        else:
            with pytest.raises(Refusal):
                it.answer(number + step, words, request)
        assert (it.payload()["question"] is None) == (first is not None)
    assert it.taken() == (None if first is None else first[0])
    with pytest.raises(Refusal, match="not open"):
        it.answer(number, "e") if first else it.answer(number + 1, "e")
