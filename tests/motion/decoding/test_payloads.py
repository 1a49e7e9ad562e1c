"""What all requests from the network have in common, and the fields of jogs, locks and obstacles."""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any, NamedTuple

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hyperbit.controller.motion.decoding import goal, setpoint
from hyperbit.controller.motion.decoding.goal import GoalRules, schedule
from hyperbit.controller.motion.decoding.payloads import MOST_BYTES
from hyperbit.controller.motion.decoding.requests import (
    MOST_OBSTACLE_BYTES,
    decode_degrade,
    decode_jog,
    decode_obstacles,
)
from hyperbit.controller.motion.stages.pacing import Pace
from hyperbit.controller.motion.tracking import bias
from hyperbit.controller.refusals.codes import INVALID_GOAL
from hyperbit.controller.refusals.refusal import LONGEST_SENTENCE, Refusal
from tests.motion.decoding.requests import json_values

LABELS = ("1.left", "1.right", "2.left")


class Request(NamedTuple):
    decode: Callable[[bytes], Any]
    fields: str  # that are needed
    most: int = MOST_BYTES  # bytes


REQUESTS = {
    "goal": Request(
        lambda payload: schedule(goal.parse(payload), GoalRules(2, 0.002, 0.05, Pace(0.06)), 1.8e9),
        "`waypoints` is",
        1_000_000,
    ),
    "setpoint": Request(lambda payload: setpoint.decode(payload, 2, 0.002), "`position` is"),
    "measured tip": Request(lambda payload: bias.decode(payload, 2), "`position` and `stamp` is"),
    "degrade": Request(decode_degrade, "`actuator` and `state` is"),
    "jog": Request(lambda payload: decode_jog(payload, LABELS), "`actuators` is"),
    "obstacles": Request(lambda payload: decode_obstacles(payload, 2), "`regions` is", MOST_OBSTACLE_BYTES),
}
requests = pytest.mark.parametrize("name", REQUESTS)


def refusal(name: str, payload: bytes) -> str:
    with pytest.raises(Refusal) as refused:
        REQUESTS[name].decode(payload)
    assert refused.value.code == INVALID_GOAL
    sentence = str(refused.value)
    assert 0 < len(sentence) <= 2 * LONGEST_SENTENCE
    assert sentence.encode()
    return sentence


@requests
def test_what_is_no_request_at_all_is_refused_with_a_sentence(name: str) -> None:
    most, needed = REQUESTS[name].most, f"{name}: an object with {REQUESTS[name].fields} needed"
    for payload, sentence in (
        (b"", f"{name} is not JSON"),
        (b"{waypoints", f"{name} is not JSON"),
        (b"{}{}", f"{name} is not JSON: Extra data"),
        (b"\xef\xbb\xbf{}", f"{name} is not JSON"),
        (b"\xff", f"{name} is not UTF-8: byte 0 is 0xff"),
        (b'{"id": "\xff"}', f"{name} is not UTF-8: byte 8 is 0xff"),
        (b"[1]", needed),
        (b"null", needed),
        (b'{"a": 1, "b": 2, "a": 3}', f"{name} is not JSON: 'a' occurs twice in one object"),
        (b'{"a": 1%s}' % (b"0" * 5_000), f"{name} is not JSON: Exceeds the limit"),
        (bytes(most + 1), f"{name} of {most + 1} bytes, at most {most} are accepted"),
    ):
        assert refusal(name, payload).startswith(sentence), payload[:20]
    assert "\\ud800: unknown field" in refusal(name, b'{"\\ud800": 1}')
    assert "(and " in refusal(name, b'{"a": 1, "b": 1, "c": 1, "d": 1, "e": 1}'), "more than three faults are counted"
    for depth in (*range(850, 1010, 9), 5_000):
        assert name in refusal(name, b"[" * depth + b"]" * depth)
        refusal(name, b'{"position": %s}' % (b"[" * depth + b"]" * depth))


def sent(*regions: object) -> bytes:
    return json.dumps({"regions": regions}).encode()


NAMED = {"disc": {"centre": [1, 2], "radius": 0.5}, "name": "crate"}
BY_FIELD = {
    "degrade": {
        b"{}": "actuator: required, but missing; state: required, but missing",
        b'{"actuator": "1.left", "state": 2}': "state: Invalid enum value 2",
        b'{"actuator": "1.left", "state": true}': "state: Expected `int | null`, got `bool`",
        b'{"actuator": 1, "state": 0}': "actuator: Expected `str`, got `int`",
        b'{"actuator": "1.left", "state": 0, "now": 1}': "now: unknown field; known are actuator, state",
    },
    "jog": {
        b"{}": "actuators: required, but missing",
        b'{"actuators": {}}': "actuators: Expected `object` of length >= 1",
        b'{"actuators": {"1.left": 1}}': "actuators[...]: Expected `str`, got `int`",
        b'{"actuators": {"1.left": "up"}}': "actuators[...]: Invalid enum value 'up'",
        b'{"actuators": {"9.left": "extended"}}': "actuators: '9.left' is no actuator of this arm; they are 1.left",
        b'{"actuators": {"1.left": "extended"}, "now": 1}': "now: unknown field; known are actuators",
    },
    "obstacles": {
        b"{}": "regions: required, but missing",
        b'{"regions": [], "now": 1}': "now: unknown field; known are regions",
        sent({"sphere": {"centre": [1, 2], "radius": 1}}): "regions[0]: one of disc, box, half_plane is needed for",
        sent({"disc": {"centre": [1, 2, 3], "radius": 1}}): "regions[0].disc.centre: 3 coordinates, a planar arm's",
        sent({"disc": {"centre": [1, 2], "radius": 0}}): "regions[0].disc.radius: Expected `float` > 0.0",
        sent(NAMED, NAMED): "regions[1].name: 'crate' is the name of another obstacle already",
        sent({}, {}, {}, {}): "regions[0]: one of disc",
    },
}


@pytest.mark.parametrize("name", BY_FIELD)
def test_what_is_wrong_with_a_request_is_named_by_field(name: str) -> None:
    for payload, sentence in BY_FIELD[name].items():
        assert refusal(name, payload).startswith(sentence)


def test_jogs_name_states_by_the_index_of_the_actuator_and_regions_come_in_their_order() -> None:
    payload = b'{"actuators": {"2.left": "extended", "1.left": "contracted"}}'
    assert decode_jog(payload, LABELS).states == {2: 1, 0: 0}
    regions = decode_obstacles(sent(NAMED, {"box": {"centre": [1, 2], "size": [1, 2]}}), 2)
    assert regions.names == ("disc 'crate'", "box regions[1]")
    assert len(decode_obstacles(sent(), 3)) == 0
    assert decode_degrade(b'{"actuator": "1.left", "state": null}').state is None


FIELDS = ("waypoints", "position", "actuator", "actuators", "regions")


@requests
@given(payload=st.binary(max_size=60) | json_values.map(lambda value: json.dumps(value).encode()), value=json_values)
def test_any_bytes_are_a_request_or_refused(name: str, payload: bytes, value: Any) -> None:
    for given_ in (payload, *(json.dumps({field: value}).encode() for field in FIELDS)):
        try:
            REQUESTS[name].decode(given_)
        except Refusal:
            refusal(name, given_)
