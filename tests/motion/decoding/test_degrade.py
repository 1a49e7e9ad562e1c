"""Requests to lock an actuator: decoding."""

import json

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hyperbit.controller.motion.decoding.requests import decode_degrade
from hyperbit.controller.refusals.refusal import Refusal
from tests.motion.decoding.requests import scalars, unreadable

anything = st.dictionaries(st.sampled_from(["actuator", "state", "now"]), scalars) | st.recursive(scalars, st.lists)


@pytest.mark.parametrize(
    ("payload", "named"),
    [
        (b"{}", "actuator: required, but missing; state: required, but missing"),
        (b'{"actuator": "1.left"}', "state: required, but missing"),
        (b'{"actuator": "1.left", "state": 2}', "state: Invalid enum value 2"),
        (b'{"actuator": "1.left", "state": true}', "state: Expected `int | null`, got `bool`"),
        (b'{"actuator": 1, "state": 0}', "actuator: Expected `str`, got `int`"),
        (b'{"actuator": "1.left", "state": 0, "now": 1}', "now: unknown field; known are actuator, state"),
        (b'{"actuator": "a", "actuator": "b", "state": 0}', "degrade is not JSON: 'actuator' occurs twice"),
        (b"[]", "degrade: an object with `actuator` and `state` is needed"),
        *unreadable("degrade"),
    ],
)
def test_what_is_wrong_with_a_request_is_named_by_field(payload: bytes, named: str) -> None:
    with pytest.raises(Refusal) as refused:
        decode_degrade(payload)
    assert str(refused.value).startswith(named)


@given(st.binary(max_size=60) | anything.map(lambda value: json.dumps(value).encode()))
def test_whatever_bytes_come_are_a_request_or_refused(payload: bytes) -> None:
    try:
        request = decode_degrade(payload)
    except Refusal:
        return
    assert isinstance(request.actuator, str)
    assert request.state in (0, 1, None)
