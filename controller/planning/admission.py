"""Admission: which requests may still begin, by their order of arrival and the executor's epoch.

A cancel, stop or reset bars every goal and every stream of set-points that arrived before it. The planner decides by
order of arrival, the executor by epoch. While a cancel is unanswered, new requests belong to the epoch that begins with
its answer.
"""

import itertools
import threading
from collections.abc import Callable
from dataclasses import dataclass

from controller.motion.codes import INVALID_GOAL, Refusal
from controller.planning.messages import BARRED

Receive = Callable[[], bytes | None]


@dataclass(frozen=True)
class Ticket:
    """The place of a request in the order of arrival.

    Attributes:
        number: among all requests and set-points.
        bars: number of requests sent to the executor before it that may begin a new epoch.
        epoch: of the executor at arrival; None if one of these was unanswered, or no snapshot had come.
    """

    number: int
    bars: int
    epoch: int | None


class Admission:
    """Numbers requests and set-points by arrival, and decides which are barred. For any thread.

    Only the latest set-point waits to be read. A waiting set-point gets its number before a request that arrives later.
    """

    def __init__(self) -> None:
        self._changed = threading.Condition()
        self._numbers = itertools.count(1)
        self._receive: Receive = lambda: None
        self._waiting: tuple[bytes, Ticket] | None = None
        self._sent = self._answered = self._passed = 0  # bars
        self._barred = self._replaced = 0  # numbers
        self._epoch: int | None = None
        self._first_epoch: int | None = None  # of the first snapshot after the last answered bar

    def read_setpoints(self, receive: Receive) -> None:
        """Sets the mailbox of set-points: `receive` returns the latest, or None, and never waits."""
        with self._changed:
            self._receive = receive

    # --- arrival

    def arrive(self) -> Ticket:
        """Returns the ticket of a request that arrives now."""
        with self._changed:
            self._number_setpoint()
            return self._ticket()

    def setpoint(self) -> tuple[bytes, Ticket] | None:
        """Returns the latest set-point with the ticket of the first one since the last call; None if none came."""
        with self._changed:
            self._number_setpoint()
            waiting, self._waiting = self._waiting, None
            return waiting

    def bar(self) -> None:
        """Bars all earlier requests: a cancel, stop or reset goes to the executor now."""
        with self._changed:
            self._number_setpoint()
            self._barred = self._ticket().number
            self._sent += 1
            self._changed.notify_all()

    def fence(self) -> None:
        """Notes that a request goes to the executor that begins a new epoch if it is accepted."""
        with self._changed:
            self._number_setpoint()
            self._sent += 1

    def end_streams(self, ticket: Ticket) -> None:
        """Ends the streams of set-points that began before an accepted goal."""
        with self._changed:
            self._replaced = max(self._replaced, ticket.number)

    # --- the executor

    def unsent(self) -> None:
        """Notes that the last such request could not be sent: there is no executor and no epoch."""
        with self._changed:
            self._answered = self._passed = self._sent

    def answered(self) -> None:
        """Notes that the executor answered such a request; if it was accepted, the epoch has grown."""
        with self._changed:
            self._answered += 1

    def snapshot(self, epoch: int) -> None:
        """Notes the epoch of a snapshot."""
        with self._changed:
            if self._passed != self._answered or self._first_epoch is None:
                self._passed, self._first_epoch = self._answered, epoch
            self._epoch = epoch
            self._changed.notify_all()

    def lost(self) -> None:
        """Bars all earlier requests: the connection to the executor is lost."""
        with self._changed:
            self._number_setpoint()
            self._barred = self._ticket().number
            self._answered = self._passed = self._sent
            self._epoch = self._first_epoch = None
            self._changed.notify_all()

    # --- decisions

    def barred(self, ticket: Ticket) -> bool:
        """Returns whether a cancel, stop, reset or fault came after a request."""
        with self._changed:
            return self._is_barred(ticket)

    def stream_ended(self, ticket: Ticket) -> bool:
        """Returns whether a stream of set-points is no longer followed, given the ticket of its first set-point."""
        with self._changed:
            return ticket.number <= self._replaced or self._is_barred(ticket)

    def epoch(self, ticket: Ticket, timeout: float) -> int | None:
        """Returns the epoch of a request; None if it is not known within the time-out.

        Raises:
            Refusal: the request is barred.
        """
        with self._changed:
            self._changed.wait_for(lambda: self._is_barred(ticket) or self._resolved(ticket) is not None, timeout)
            if self._is_barred(ticket):
                raise Refusal(INVALID_GOAL, BARRED)
            return self._resolved(ticket)

    def _resolved(self, ticket: Ticket) -> int | None:
        if ticket.epoch is not None:
            return ticket.epoch
        return self._first_epoch if self._passed == ticket.bars else None

    def _is_barred(self, ticket: Ticket) -> bool:
        epoch = self._resolved(ticket)
        changed = epoch is not None and self._epoch is not None and epoch != self._epoch
        return ticket.number <= self._barred or changed

    def _ticket(self) -> Ticket:
        epoch = self._epoch if self._passed == self._sent else None
        return Ticket(next(self._numbers), self._sent, epoch)

    def _number_setpoint(self) -> None:
        if (payload := self._receive()) is not None:
            self._waiting = payload, self._waiting[1] if self._waiting else self._ticket()
