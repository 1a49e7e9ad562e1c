"""Admission: which requests may still begin, by their order of arrival and the executor's epoch.

A cancel, stop or reset bars every goal and every stream of set-points that arrived before it. The planner decides by
order of arrival, the executor by epoch. While a cancel is unanswered, new requests belong to the epoch that begins with
its answer.
"""

from __future__ import annotations

from dataclasses import dataclass

BARRED = "a cancel, stop, reset or fault came before it began"


@dataclass(eq=False)
class Ticket:
    """The place of a request in the order of arrival.

    Attributes:
        number: among all requests and set-points.
        epoch: of the executor at arrival; None while it is not known.
        waits_for: the executor's requests that were unanswered at arrival, and may begin a new epoch.
    """

    number: int
    epoch: int | None
    waits_for: frozenset[int]


class Admission:
    """Numbers requests and set-points by arrival, and decides which are barred."""

    def __init__(self) -> None:
        self._last = self._barred = self._replaced = 0  # numbers of tickets
        self._pending: frozenset[int] = frozenset()  # the executor's requests that may begin a new epoch
        self._epoch: int | None = None  # of the last snapshot
        self._current = False  # whether that snapshot came after the last answer
        self._unresolved: list[Ticket] = []

    def arrive(self) -> Ticket:
        """Returns the ticket of a request that arrives now."""
        self._last += 1
        ticket = Ticket(self._last, self._epoch if self._current and not self._pending else None, self._pending)
        if ticket.epoch is None:
            self._unresolved.append(ticket)
        return ticket

    def bar(self, request: int) -> None:
        """Bars all earlier requests: a cancel, stop or reset goes to the executor as its request of this number."""
        self._last += 1
        self._barred = self._last
        self._unresolved.clear()
        self.fence(request)

    def fence(self, request: int) -> None:
        """Notes a request to the executor that begins a new epoch if the executor accepts it."""
        self._pending |= {request}

    def end_streams(self, ticket: Ticket) -> None:
        """Ends the streams of set-points that began before an accepted goal."""
        self._replaced = max(self._replaced, ticket.number)

    # --- the executor

    def answered(self, request: int) -> None:
        """Notes that the executor answered such a request, or that it could not be sent."""
        if request in self._pending:
            self._pending -= {request}
            self._current = False

    def snapshot(self, epoch: int) -> None:
        """Notes the epoch of a snapshot."""
        self._epoch, self._current = epoch, True
        waiting = [ticket for ticket in self._unresolved if ticket.waits_for & self._pending]
        for ticket in self._unresolved:
            if ticket not in waiting:
                ticket.epoch = epoch
        self._unresolved = waiting

    def lost(self) -> None:
        """Bars all earlier requests: the connection to the executor is lost."""
        self._last += 1
        self._barred = self._last
        self._pending, self._epoch, self._current = frozenset(), None, False
        self._unresolved.clear()

    # --- decisions

    def barred(self, ticket: Ticket) -> bool:
        """Returns whether a cancel, stop, reset or fault came after a request."""
        changed = ticket.epoch is not None and self._epoch is not None and ticket.epoch != self._epoch
        return ticket.number <= self._barred or changed

    def stream_ended(self, ticket: Ticket) -> bool:
        """Returns whether a stream of set-points is no longer followed, given the ticket of its first set-point."""
        return ticket.number <= self._replaced or self.barred(ticket)
