"""Notes on requests: a recorder receives each request with its answer, other subscribers none. Floods of requests."""

import json
from typing import Any

import pytest
import zenoh

from hyperbit.controller.gateway.arrivals import MOST_AT_ONCE, PAUSE, PAUSE_EVERY, Clocks, FloodBrake, Rate
from hyperbit.controller.gateway.server import MOST_NOTES
from hyperbit.controller.gateway.server import noted as note_of
from hyperbit.controller.messages.goals import done
from tests.gateway.conftest import ARM, GOAL, PREFIX, Gateway, asked
from tests.waiting import eventually


def noted(gateway: Gateway, expression: str = "hyperbit/*/@request") -> list[dict[str, Any]]:
    """The notes that a recorder receives from now on."""
    heard: list[dict[str, Any]] = []
    session = gateway.other()
    session.declare_subscriber(expression, lambda sample: heard.append(json.loads(sample.payload.to_bytes())))
    if expression.endswith("@request"):
        eventually(lambda: gateway.outbox.recorded())
    else:
        gateway.reached()
    return heard


@pytest.mark.parametrize("key", ["goal", "jog", "cancel", "stop", "reset", "degrade", "obstacles", "plan"])
def test_a_request_is_noted_with_its_answer(gateway: Gateway, key: str) -> None:
    notes = noted(gateway)
    (answer,) = asked(gateway.other(), f"{PREFIX}/{key}")
    (note,) = eventually(lambda: notes)
    assert (note["key"], note["payload"], note["answer"]) == (key, json.loads(GOAL), answer)
    assert note["stamp"] > 1e9


def test_puts_and_repeated_goals_are_noted(gateway: Gateway) -> None:
    notes, session = noted(gateway), gateway.other()
    session.put(f"{PREFIX}/goal", GOAL)
    eventually(lambda: len(notes) == 1)
    session.put(f"{PREFIX}/goal", GOAL)
    eventually(lambda: len(notes) == 2)
    assert notes[0]["answer"] == notes[1]["answer"]


def test_what_is_no_json_is_noted_as_text(gateway: Gateway) -> None:
    notes = noted(gateway)
    asked(gateway.other(), f"{PREFIX}/goal", b"no \xff JSON")
    (note,) = eventually(lambda: notes)
    assert (note["payload"], note["text"], note["answer"]["accepted"]) == (None, "no � JSON", False)
    asked(gateway.other(), f"{PREFIX}/stop", b"")
    assert eventually(lambda: notes[1:])[0]["payload"] is None


def test_what_is_nested_too_deeply_is_noted_as_text() -> None:
    assert note_of(1.0, "goal", b"[" * 100_000, done("")).text == "[" * 500
    assert note_of(1.0, "goal", b'{"with": ' + b"[" * 100_000, done("")).payload is None


@pytest.mark.parametrize("payload", [b'"\xff"', b'{"id":"\xff"}', b'{"id":"\xed\xa0\x80"}'])
def test_what_is_no_utf8_within_a_text_is_noted_as_text(payload: bytes) -> None:
    assert note_of(1.0, "goal", payload, done("")).payload is None


def test_a_stop_whose_payload_is_no_utf8_is_carried_out_and_answered_while_a_recorder_listens(gateway: Gateway) -> None:
    notes = noted(gateway)
    (answer,) = asked(gateway.other(), f"{PREFIX}/stop", b'"\xff"')
    assert answer["accepted"]
    assert eventually(lambda: notes)[0]["answer"] == answer


def test_a_wildcard_hears_no_notes(gateway: Gateway) -> None:
    notes = noted(gateway, f"hyperbit/{ARM}/**")
    asked(gateway.other(), f"{PREFIX}/goal")
    asked(gateway.other(), f"{PREFIX}/degrade")
    gateway.reached()
    assert not [note for note in notes if "key" in note]
    assert not gateway.outbox.recorded()


def test_a_flood_of_refused_requests_is_noted_in_part(gateway: Gateway) -> None:
    notes, session = noted(gateway), gateway.other()
    for _ in range(3 * MOST_NOTES):
        session.put(f"{PREFIX}/degrade", GOAL, congestion_control=zenoh.CongestionControl.BLOCK)
    asked(session, f"{PREFIX}/stop", b"")
    eventually(lambda: any(note["key"] == "stop" for note in notes))
    eventually(lambda: gateway.planner.keys().count("degrade") == 3 * MOST_NOTES)
    gateway.reached()
    assert sum(note["key"] == "degrade" for note in notes) >= MOST_NOTES


class Time:
    def __init__(self) -> None:
        self.now, self.pauses = 100.0, list[float]()

    def brake(self) -> FloodBrake:
        return FloodBrake(lambda: self.now, self.pauses.append)


def test_a_flood_is_refused_briefly_and_slowed_down() -> None:
    time = Time()
    brake, explained = time.brake(), 0
    for _ in range(MOST_AT_ONCE + 10 * PAUSE_EVERY):
        explained += brake.explained.admits()
        brake.refused.add()
        brake.slow_down()
    assert explained == MOST_AT_ONCE
    assert time.pauses == [PAUSE] * 10
    time.now += 1.0
    assert brake.explained.admits()
    brake.slow_down()
    assert len(time.pauses) == 10


def test_requests_that_are_accepted_are_not_slowed_down() -> None:
    time = Time()
    brake = time.brake()
    for _ in range(MOST_AT_ONCE - 1):
        brake.refused.add()
    for _ in range(10 * PAUSE_EVERY):
        brake.slow_down()
    assert time.pauses == []


def test_a_rate_is_of_any_second() -> None:
    time = Time()
    rate, admitted = Rate(2, lambda: time.now), list[bool]()
    for _ in range(8):
        admitted.append(rate.admits())
        time.now += 0.3
    assert admitted == [True, True, False, False, True, True, False, False]


def test_in_a_flood_a_refusal_says_that_it_gives_no_reason(gateway: Gateway) -> None:
    gateway.server.close()
    gateway.server = gateway.serve(Clocks(monotonic=lambda: 100.0, pause=lambda seconds: None))
    session = gateway.other()
    reasons = [asked(session, f"hyperbit/{ARM}/goal", b"\xff")[0]["reason"] for _ in range(MOST_AT_ONCE + 1)]
    assert reasons == ["not-utf8"] * MOST_AT_ONCE + ["not-explained"]
    assert not gateway.planner.heard
