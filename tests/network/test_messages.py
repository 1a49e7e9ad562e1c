"""Forms of a daemon's messages: what clients take, and what they count."""

import json
import logging
from typing import Any

import pytest

from hyperbit.controller.decoding.decoding import Unreadable
from hyperbit.controller.network.messages import TELL_EVERY, UnreadCount, filled, read
from tests.clock import Clock

STATE = {"mode": "ready", "reason": "holding", "commanded": [0, 1], "measured": [None, 1], "from_a_later_version": 1}


def written(**fields: Any) -> bytes:
    return json.dumps({**STATE, **fields}).encode()


def test_a_message_stays_as_it_is_and_absent_fields_have_defaults_when_asked_for() -> None:
    assert read("state", written()) == STATE
    full = filled("state", STATE)
    assert (full["faults"], full["tip"], full["from_a_later_version"]) == ([], None, 1)
    assert read("later_key", b'{"a": 1}') == {"a": 1}


@pytest.mark.parametrize(
    "fields",
    [{"mode": 1}, {"faults": 3}, {"faults": [{"code": "stuck"}]}, {"stamp": 1e300}, {"tip": [1, 2]}, {"measured": [0]}],
)
def test_a_state_of_another_form_is_unreadable(fields: dict[str, Any]) -> None:
    with pytest.raises(Unreadable):
        read("state", written(**fields))


def test_unread_messages_are_counted_and_told_once_a_minute(caplog: pytest.LogCaptureFixture) -> None:
    clock = Clock()
    unread = UnreadCount(clock)
    with caplog.at_level(logging.WARNING):
        for _ in range(1000):
            unread.add("a", "state", Unreadable("odd"))
        clock.now += TELL_EVERY
        unread.add("a", "result", Unreadable("cut"))
    assert [record.getMessage() for record in caplog.records] == [
        "arm a: state cannot be read: odd (1 such messages so far)",
        "arm a: result cannot be read: cut (1001 such messages so far)",
    ]
