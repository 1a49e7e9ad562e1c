"""Forms of a daemon's messages, and endpoints: their parts, and who has a port."""

from __future__ import annotations

import json
import logging
import os
import socket
from typing import Any

import pytest
from msgspec import convert

from hyperbit.controller.decoding.decoding import Unreadable
from hyperbit.controller.messages.reading import TELL_EVERY, UnreadCount, read
from hyperbit.controller.messages.state import State
from hyperbit.controller.network.endpoints import owner_of, parse_endpoint, port_taken
from tests.clock import Clock

STATE = {"mode": "ready", "reason": "holding", "commanded": [0, 1], "measured": [None, 1], "from_a_later_version": 1}


def written(**fields: Any) -> bytes:
    return json.dumps({**STATE, **fields}).encode()


def test_a_message_stays_as_it_is_and_its_type_has_defaults_of_absent_fields() -> None:
    assert read("state", written()) == STATE
    full = convert(STATE, State)
    assert (full.faults, full.tip, full.measured) == ([], None, [None, 1])
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


@pytest.mark.parametrize(
    ("endpoint", "address"),
    [
        ("tcp/127.0.0.1:7447", ("127.0.0.1", 7447)),
        ("tls/robot.local:7447#root_ca_certificate=ca.pem", ("robot.local", 7447)),
        ("tcp/[::1]:1?rel=1", ("::1", 1)),
        ("ws/localhost:0", ("localhost", 0)),
        ("udp/localhost:7447", None),
        ("unixsock-stream/a.sock", None),
    ],
)
def test_the_address_of_an_endpoint(endpoint: str, address: tuple[str, int] | None) -> None:
    assert parse_endpoint(endpoint).address == address


@pytest.mark.parametrize(
    ("endpoint", "hint"),
    [
        ("127.0.0.1:7447", "such as tcp/127.0.0.1:7447; write tcp/127.0.0.1:7447"),
        ("tcp/127.0.0.1", "PROTOCOL/HOST:PORT is needed, such as tcp/127.0.0.1:7447"),
        ("tcp/127.0.0.1:seven", "PROTOCOL/HOST:PORT is needed"),
        ("tcp/127.0.0.1:70000", "PROTOCOL/HOST:PORT is needed"),
        ("tcp/::1:7447", "an IPv6 address stands in brackets, such as [::1]"),
        ("http://127.0.0.1:7447", "protocols are tcp, tls, ws, quic, udp, unixsock-stream"),
        ("TCP/127.0.0.1:7447", "protocols are tcp"),
        ("tcp/ robot:7447", "PROTOCOL/HOST:PORT is needed"),
        ("", "PROTOCOL/HOST:PORT is needed"),
    ],
)
def test_what_is_no_endpoint_is_refused_with_what_is_right(endpoint: str, hint: str) -> None:
    with pytest.raises(ValueError, match="is no endpoint") as caught:
        parse_endpoint(endpoint)
    assert hint in str(caught.value)


def test_a_port_that_is_taken_is_told_with_its_process_and_both_ways_out() -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        told = port_taken(f"tcp/127.0.0.1:{port}")
        assert (owner_of(port) or "").endswith(f"(process {os.getpid()})")
    assert told is not None
    assert told.startswith(f"port {port} of 127.0.0.1 is taken by ")
    assert f"--connect tcp/127.0.0.1:{port}" in told
    assert told.endswith(f"--listen tcp/127.0.0.1:{port + 1}")
    assert port_taken("unixsock-stream/a.sock") is None
