"""Requests to switch single actuators: decoding."""

import json

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hyperbit.controller.motion.decoding.requests import decode_jog
from hyperbit.controller.refusals.refusal import Refusal
from tests.motion.decoding.requests import scalars, unreadable

LABELS = ("1.left", "1.right", "2.left")
words = st.sampled_from(["contracted", "extended", "free", "1.left", "actuators"])
anything = st.dictionaries(words, scalars | st.dictionaries(st.sampled_from(LABELS), words | scalars))


@pytest.mark.parametrize(
    ("payload", "named"),
    [
        (b"{}", "actuators: required, but missing"),
        (b'{"actuators": {}}', "actuators: Expected `object` of length >= 1"),
        (b'{"actuators": {"1.left": 1}}', "actuators[...]: Expected `str`, got `int`"),
        (b'{"actuators": {"1.left": "up"}}', "actuators[...]: Invalid enum value 'up'"),
        (b'{"actuators": {"9.left": "extended"}}', "actuators: '9.left' is no actuator of this arm; they are 1.left"),
        (b'{"actuators": {"1.left": "extended"}, "now": 1}', "now: unknown field; known are actuators"),
        (b'{"actuators": {"a": "extended", "a": "extended"}}', "jog is not JSON: 'a' occurs twice in one object"),
        (b"[]", "jog: an object with `actuators` is needed"),
        *unreadable("jog"),
    ],
)
def test_an_invalid_request_is_refused_by_field(payload: bytes, named: str) -> None:
    with pytest.raises(Refusal) as refused:
        decode_jog(payload, LABELS)
    assert str(refused.value).startswith(named)


def test_states_are_given_by_the_index_of_the_actuator() -> None:
    payload = b'{"actuators": {"2.left": "extended", "1.left": "contracted"}}'
    assert decode_jog(payload, LABELS).states == {2: 1, 0: 0}


@given(st.binary(max_size=60) | anything.map(lambda value: json.dumps(value).encode()))
def test_any_bytes_are_a_request_or_refused(payload: bytes) -> None:
    try:
        states = decode_jog(payload, LABELS).states
    except Refusal:
        return
    assert states
    assert all(index in range(3) and state in (0, 1) for index, state in states.items())
