"""Each reason is given somewhere, with the facts of its sentence; a refusal raises nothing but itself."""

from __future__ import annotations

import pickle
import re
import string

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hyperbit.controller.refusals import codes
from hyperbit.controller.refusals.reasons import Reason, advice
from hyperbit.controller.refusals.refusal import LONGEST_SENTENCE, Refusal, Refused, no_motion
from tests.refusals.raised import calls, made

FACTS = st.one_of(st.text(), st.integers(), st.floats(), st.just("{size}"), st.just("\ud800"), st.just("x" * 2_000))


def fields(template: str) -> list[tuple[str, str, str]]:
    """Returns name, format and conversion of each field in a template."""
    return [
        (name, spec or "", way or "") for _, name, spec, way in string.Formatter().parse(template) if name is not None
    ]


def facts_of(reason: Reason) -> set[str]:
    return {name for name, _, _ in fields(reason.sentence)}


@pytest.mark.parametrize("reason", Reason)
def test_a_reason_has_a_name_a_code_and_plain_templates(reason: Reason) -> None:
    assert reason.value == reason.name.lower().replace("_", "-")
    assert reason.code in (codes.INVALID_GOAL, codes.OLD_HEADER_TIMESTAMP, codes.GOAL_TOLERANCE_VIOLATED)
    for name, spec, conversion in fields(reason.sentence):
        assert re.fullmatch(r"[a-z_]+", name), "a name alone cannot fail"
        assert (spec, conversion) == ("", "")
    assert {name for name, _, _ in fields(reason.advice)} <= {"arm"}
    assert not {"|", "\n"} & {*reason.sentence, *reason.advice}


def test_each_reason_is_given_somewhere() -> None:
    assert {it.reason for it in made()} == set(Reason)


@pytest.mark.parametrize("it", made(), ids=lambda it: f"{it.reason.value}-{it.where}")
def test_each_refusal_brings_the_facts_of_its_sentence(it) -> None:
    assert it.facts == facts_of(it.reason), it.where


def test_a_reason_that_is_no_literal_comes_with_its_facts_from_another_refusal() -> None:
    others = {where for where, _ in calls()} - {it.where for it in made()}
    assert {where.partition(":")[0] for where in others} == {"refusals/refusal.py"}  # of `Refused`


@given(st.sampled_from(Reason), st.data())
def test_a_sentence_is_filled_by_its_facts_whatever_they_are(reason: Reason, data: st.DataObject) -> None:
    facts = {name: data.draw(FACTS) for name in sorted(facts_of(reason))}
    refusal = Refusal(reason, **facts)
    sentence = str(refusal)
    assert 0 <= len(sentence) <= LONGEST_SENTENCE
    assert sentence.encode() is not None
    assert msgspec.msgpack.decode(msgspec.msgpack.encode(refusal.data), type=Refused).refusal.reason is reason
    assert str(pickle.loads(pickle.dumps(refusal))) == sentence


@given(st.sampled_from(Reason))
def test_a_missing_fact_stays_as_its_name_and_raises_nothing(reason: Reason) -> None:
    assert str(Refusal(reason)) == reason.sentence[:LONGEST_SENTENCE]
    assert str(Refusal(reason, other=1.5)) == reason.sentence


@pytest.mark.parametrize("reason", Reason)
def test_the_facts_survive_the_contract(reason: Reason) -> None:
    refusal = Refusal(reason, **{name: f"<{name}>" for name in facts_of(reason)})
    told = msgspec.msgpack.decode(msgspec.msgpack.encode(refusal.data), type=Refused).refusal
    assert (told.reason, str(told), told.code) == (reason, str(refusal), reason.code)
    assert "{" not in str(told)


@pytest.mark.parametrize(
    ("reason", "told"),
    [
        ("arm-stopped", "leave the stop by: hyperbit reset a"),
        ("not-named", ""),
        ("of-the-future", ""),
        (None, ""),
        ([], ""),
    ],
)
def test_the_advice_names_the_arm_and_is_empty_for_what_is_not_known(reason: object, told: str) -> None:
    assert advice(reason, "a") == told


@pytest.mark.parametrize("mode", ["starting", "ready", "executing", "fault", "stopped"])
def test_each_mode_has_a_refusal(mode: str) -> None:
    refusal = no_motion(mode, "because")
    assert mode in str(refusal)
    assert "because" in str(refusal)
