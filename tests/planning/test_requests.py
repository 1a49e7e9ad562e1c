"""Decoding of requests: contents, refusals, and no other exception."""

import json
from typing import Any, get_args

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hyperbit.controller.arm.arm import Arm
from hyperbit.controller.motion.decoding.goal import BEGIN_WITHIN, GoalMessage, Jog
from hyperbit.controller.motion.decoding.requests import DegradeMessage, FaultMessage
from hyperbit.controller.planning.core.events import CancelMessage, Key, SentObstacles
from hyperbit.controller.planning.planner import RequestDecoder
from hyperbit.controller.refusals.codes import GOAL_TOLERANCE_VIOLATED, INVALID_GOAL
from hyperbit.controller.refusals.refusal import Refusal
from tests.fuzz.mutations import wrong
from tests.told import CONFIGURATIONS, DEGRADE, GOAL, JOG, LINE, OBSTACLES, SETPOINT

KEYS: tuple[Key, ...] = get_args(Key)
NO_JSON = b"\xff\xfe"


@pytest.fixture(scope="module")
def decoder(small: Arm) -> RequestDecoder:
    return RequestDecoder(small)


def payload(value: Any) -> bytes:
    return json.dumps(value).encode()


@pytest.mark.parametrize("key", ["goal", "plan"])
def test_a_goal(decoder: RequestDecoder, key: Key) -> None:
    message = decoder.decode(key, payload({"id": "a", "waypoints": [{"position": [0.1, 0.8]}]}))
    assert isinstance(message, GoalMessage)
    assert (message.id, message.waypoints[0].position) == ("a", [0.1, 0.8])


@pytest.mark.parametrize("key", ["goal", "plan"])
def test_a_goal_far_out_of_reach_is_refused_with_its_id(decoder: RequestDecoder, key: Key) -> None:
    far = {"id": "a", "waypoints": [{"position": [0.1, 0.8]}, {"t": 1.0, "position": [1.5, 2.0]}]}
    with pytest.raises(Refusal, match=r"waypoint 2, position: \(1.5, 2\) is out of reach: 2.5 from the base") as told:
        decoder.decode(key, payload(far))
    assert (told.value.code, told.value.goal) == (GOAL_TOLERANCE_VIOLATED, "a")


def test_a_position_within_its_tolerance_is_left_to_the_search(decoder: RequestDecoder) -> None:
    decoder.decode("goal", payload({"waypoints": [{"position": [1.5, 2.0]}], "tolerance": {"position": 2.0}}))


def test_a_position_of_another_dimension_is_left_to_the_schedule(decoder: RequestDecoder) -> None:
    decoder.decode("goal", payload({"waypoints": [{"position": [1.5, 2.0, 9.0]}]}))


def test_other_contents(decoder: RequestDecoder) -> None:
    assert decoder.decode("jog", payload({"actuators": {"1.right": "extended"}})) == Jog({2: 1}, BEGIN_WITHIN)
    assert decoder.decode("degrade", payload({"actuator": "1.left", "state": None})) == DegradeMessage("1.left", None)
    assert decoder.decode("fault", payload({"fault": "silence can0/5"})) == FaultMessage("silence can0/5")
    sent = decoder.decode("obstacles", payload(OBSTACLES))
    assert isinstance(sent, SentObstacles)
    assert sent.regions == OBSTACLES["regions"]
    assert decoder.decode("obstacles", payload({"regions": []})).obstacles != sent.obstacles  # type: ignore[union-attr]


@pytest.mark.parametrize("key", ["stop", "reset", "arm"])
def test_keys_without_a_content(decoder: RequestDecoder, key: Key) -> None:
    assert decoder.decode(key, NO_JSON) is None


def test_a_cancel_of_one_goal(decoder: RequestDecoder) -> None:
    assert decoder.decode("cancel", b'{"id": "a 1"}') == CancelMessage("a 1")


@pytest.mark.parametrize("data", [b"", b"{}", b'{"id": null}', b'{"goal": "a"}'])
def test_a_cancel_without_an_id_cancels_whatever_runs(decoder: RequestDecoder, data: bytes) -> None:
    assert decoder.decode("cancel", data) == CancelMessage()


IMPOSSIBLE = [b'{"id": 1}', b'{"id": ""}', b'{"id": "\xc3\xa4"}', b'{"id": ["a"]}', b'{"id": "a", "id": "b"}', b'"id"']
OTHER_FORMS = [b"null", b"[]", b'"a"', NO_JSON, b"[" * 100_000, b'{"id": "a"', b'{"id": "a"}' + b" " * 100_000]


@pytest.mark.parametrize("data", [*IMPOSSIBLE, *OTHER_FORMS])
def test_a_cancel_that_cannot_be_read_cancels_whatever_runs(decoder: RequestDecoder, data: bytes) -> None:
    message = decoder.decode("cancel", data)
    assert isinstance(message, CancelMessage)
    assert message.goal is None
    assert message.unread


@pytest.mark.parametrize("key", ["goal", "plan", "jog", "degrade", "obstacles"])
def test_what_cannot_be_read_is_refused(decoder: RequestDecoder, key: Key) -> None:
    for data in (b"", NO_JSON, b"{}", b"[" * 100_000):
        with pytest.raises(Refusal) as told:
            decoder.decode(key, data)
        assert told.value.code == INVALID_GOAL


@given(st.sampled_from(KEYS), wrong(GOAL, LINE, CONFIGURATIONS, JOG, SETPOINT, DEGRADE, OBSTACLES, {"id": "a"}))
def test_nothing_but_refusals(decoder: RequestDecoder, key: Key, data: bytes) -> None:
    told = ""
    try:
        message = decoder.decode(key, data)
        told = message.unread if isinstance(message, CancelMessage) else ""
    except Refusal as refusal:
        told = str(refusal)
        assert key != "cancel"
    assert told.isprintable()
    assert not told or key not in ("stop", "reset", "arm")
