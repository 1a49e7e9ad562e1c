"""Places of connections: strangers, viewers and operators are apart, and a new connection always finds a place."""

import socket
from collections.abc import Iterator
from contextlib import ExitStack

import pytest

from hyperbit.controller.panel.access import doors
from hyperbit.controller.panel.access.doors import CountedSocket, Doors


class Ends:
    """Connections to the server, and what their other ends see."""

    def __init__(self, closing: ExitStack) -> None:
        self.doors, self._closing, self._others = Doors(), closing, dict[doors.Peer, socket.socket]()

    def connect(self, address: str, port: int) -> doors.Peer:
        own, other = (self._closing.enter_context(it) for it in socket.socketpair())
        other.setblocking(False)
        self._others[address, port] = other
        self.doors.enter((address, port), own)
        return address, port

    def open(self) -> set[doors.Peer]:
        """The peers whose connections the server has not closed."""
        found = set()
        for peer, other in self._others.items():
            try:
                other.recv(1)
            except BlockingIOError:
                found.add(peer)
        return found


@pytest.fixture
def ends(monkeypatch: pytest.MonkeyPatch) -> Iterator[Ends]:
    monkeypatch.setattr(doors, "MOST", {"stranger": 4, "viewer": 2, "operator": 2})
    with ExitStack() as closing:
        yield Ends(closing)


def test_the_oldest_stranger_of_the_busiest_address_is_closed(ends: Ends) -> None:
    peers = [ends.connect("a", 1), ends.connect("b", 1), *(ends.connect("b", port) for port in (2, 3, 4, 5))]
    assert ends.open() == {peers[0], *peers[3:]}


def test_strangers_close_nobody_with_a_session(ends: Ends) -> None:
    known = [ends.connect("proxy", 1), ends.connect("proxy", 2)]
    for peer, role in zip(known, ("operator", "viewer"), strict=True):
        ends.doors.recognize(peer, role)  # type: ignore[arg-type]
    page = ends.connect("proxy", 3)
    ends.doors.leave(page)
    strangers = [ends.connect("proxy", port) for port in range(10, 30)]
    assert ends.open() == {*known, page, *strangers[-4:]}


def test_viewers_close_no_operator(ends: Ends) -> None:
    operator, *viewers = (ends.connect("a", port) for port in range(4))
    ends.doors.recognize(operator, "operator")
    for peer in viewers:
        ends.doors.recognize(peer, "viewer")
    assert ends.open() == {operator, *viewers[-2:]}


def test_a_connection_that_a_proxy_uses_for_a_stranger_again_is_a_strangers(ends: Ends) -> None:
    peer = ends.connect("proxy", 1)
    ends.doors.recognize(peer, "operator")
    ends.doors.recognize(peer, None)
    later = [ends.connect("proxy", port) for port in range(2, 6)]
    assert ends.open() == set(later)
    ends.doors.recognize(("unknown", 1), "operator")
    ends.doors.recognize(None, None)


def test_a_connection_is_counted_before_it_sends_anything(ends: Ends) -> None:
    with CountedSocket(socket.create_server(("127.0.0.1", 0)), ends.doors) as listening:
        ports = []
        for _ in range(6):
            client = ends._closing.enter_context(socket.create_connection(listening.getsockname()))
            ends._closing.enter_context(listening.accept()[0])
            ports.append(client)
        assert [client.recv(1) for client in ports[:2]] == [b"", b""]
