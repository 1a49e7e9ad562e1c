"""Notes on requests: a recorder receives each request with its answer, other subscribers none."""

import json
from typing import Any

import pytest
import zenoh

from hyperbit.controller.gateway.server import MOST_NOTES, noted_content
from tests.gateway.conftest import ARM, Gateway
from tests.gateway.test_server import PREFIX, asked
from tests.waiting import eventually

GOAL = b'{"id": "x", "waypoints": []}'


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
    assert noted_content(b"[" * 100_000)["text"] == "[" * 500
    assert noted_content(b'{"with": ' + b"[" * 100_000)["payload"] is None


@pytest.mark.parametrize("payload", [b'"\xff"', b'{"id":"\xff"}', b'{"id":"\xed\xa0\x80"}'])
def test_what_is_no_utf8_within_a_text_is_noted_as_text(payload: bytes) -> None:
    assert noted_content(payload)["payload"] is None


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
