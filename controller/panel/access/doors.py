"""Places of connections: a stranger, who has shown no session yet, takes no place of a person who has."""

import contextlib
import logging
import socket
import time
from collections import Counter
from typing import Any, Literal

from hyperbit.controller.panel.access.people import Role

log = logging.getLogger(__name__)

# Most connections of each group. With the open pages, which have their own places, they need below 1024 descriptors.
MOST = {"stranger": 200, "viewer": 150, "operator": 150}
TELL_EVERY = 60.0  # [s] between two lines of the log on connections of strangers that were closed

Group = Literal["stranger"] | Role
Peer = tuple[str, int]  # address and port of the other end


class Doors:
    """The connections to the page's server, except those of open pages. Used only on the event loop of the pages.

    A new connection is a stranger's until one of its requests shows a session. A full group closes its oldest
    connection, of the address that has the most. So a new one always finds a place, and has time to show its session.
    """

    def __init__(self) -> None:
        self._groups: dict[Group, dict[Peer, socket.socket]] = {"stranger": {}, "viewer": {}, "operator": {}}
        self._told = -TELL_EVERY

    def enter(self, peer: Peer, connection: socket.socket) -> None:
        self._put("stranger", peer, connection)

    def recognize(self, peer: Peer | None, role: Role | None) -> None:
        """Puts a connection into the group of its latest request; `role` is None without a session."""
        group: Group = role or "stranger"
        if peer is None or (group == "stranger" and peer in self._groups["stranger"]):
            return
        if (connection := self.leave(peer)) is not None:
            self._put(group, peer, connection)

    def leave(self, peer: Peer | None) -> socket.socket | None:
        """Ends the count of a connection, such as that of an open page; returns it, if it was counted."""
        found = [it for members in self._groups.values() if (it := members.pop(peer, None)) is not None]  # type: ignore[arg-type]
        return found[0] if found else None

    def _put(self, group: Group, peer: Peer, connection: socket.socket) -> None:
        members = self._groups[group]
        members[peer] = connection
        if len(members) <= MOST[group]:
            return
        for closed in [it for it, opened in members.items() if opened.fileno() < 0]:
            del members[closed]
        if len(members) <= MOST[group]:
            return
        (most, count), *_ = Counter(address for address, _ in members).most_common(1)
        oldest = members.pop(next(it for it in members if it[0] == most))
        with contextlib.suppress(OSError):  # the other end has closed it
            oldest.shutdown(socket.SHUT_RDWR)
        if (now := time.monotonic()) >= self._told + TELL_EVERY:
            self._told = now
            log.warning("too many connections of %ss: the oldest of %s, which has %d, are closed", group, most, count)


class CountedSocket(socket.socket):
    """A listening socket whose connections are counted from their arrival, before TLS and HTTP."""

    def __init__(self, listening: socket.socket, doors: Doors) -> None:
        super().__init__(fileno=listening.detach())
        self._doors = doors

    def accept(self) -> tuple[socket.socket, Any]:
        connection, address = super().accept()
        self._doors.enter(address[:2], connection)
        return connection, address
