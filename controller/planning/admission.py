"""Which requests may still begin: their order of arrival, and the executor's epoch at that moment.

A cancel, stop or reset bars every goal and every stream of set-points that arrived before it. The planner knows that by
the order of arrival; the executor knows it by its epoch. A request that arrives while such a cancel is not yet answered
belongs to the epoch that the executor begins with the answer.
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
    """A request's place.

    Attributes:
        number: by arrival, among all requests and set-points.
        bars: how many requests that may begin a new epoch were sent to the executor before it.
        epoch: the executor's at arrival; None: one of these was not answered yet, or no snapshot came.
    """

    number: int
    bars: int
    epoch: int | None


class Admission:
    """Numbers requests and set-points by arrival and knows which are barred. For any thread.

    Of set-points only the latest waits to be read. Before a request is numbered, a waiting set-point is, so that it
    counts as earlier.
    """

    def __init__(self) -> None:
        self._changed = threading.Condition()
        self._numbers = itertools.count(1)
        self._receive: Receive = lambda: None
        self._waiting: tuple[bytes, Ticket] | None = None
        self._sent = self._answered = self._passed = 0  # bars
        self._barred = self._replaced = 0  # numbers
        self._epoch: int | None = None
        self._first_epoch: int | None = None  # of the first snapshot after the last bar that was answered

    def read_setpoints(self, receive: Receive) -> None:
        """Takes set-points from a mailbox: `receive` returns the latest, None if there is none, and never waits."""
        with self._changed:
            self._receive = receive

    # --- arrivals

    def arrive(self) -> Ticket:
        """Returns the place of a request that comes now."""
        with self._changed:
            self._number_setpoint()
            return self._ticket()

    def setpoint(self) -> tuple[bytes, Ticket] | None:
        """Returns the latest set-point, and the place of the first since the last call; None if none came."""
        with self._changed:
            self._number_setpoint()
            waiting, self._waiting = self._waiting, None
            return waiting

    def bar(self) -> None:
        """Bars all that came so far, because a cancel, stop or reset is sent to the executor now."""
        with self._changed:
            self._number_setpoint()
            self._barred = self._ticket().number
            self._sent += 1
            self._changed.notify_all()

    def fence(self) -> None:
        """Notes that a request is sent to the executor that may begin a new epoch: what came before is barred then."""
        with self._changed:
            self._number_setpoint()
            self._sent += 1

    def end_streams(self, ticket: Ticket) -> None:
        """Ends the streams of set-points that began before a goal, because that goal was accepted."""
        with self._changed:
            self._replaced = max(self._replaced, ticket.number)

    # --- the executor

    def unsent(self) -> None:
        """Notes that such a request could not be sent: there is no executor, and no epoch."""
        with self._changed:
            self._answered = self._passed = self._sent

    def answered(self) -> None:
        """Notes that the executor answered such a request: if it was accepted, the epoch has grown."""
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
        """Bars all that came so far, because the connection to the executor is lost."""
        with self._changed:
            self._number_setpoint()
            self._barred = self._ticket().number
            self._answered = self._passed = self._sent
            self._epoch = self._first_epoch = None
            self._changed.notify_all()

    # --- verdicts

    def barred(self, ticket: Ticket) -> bool:
        """Returns whether a cancel, stop, reset or fault came after a request."""
        with self._changed:
            return self._is_barred(ticket)

    def stream_ended(self, ticket: Ticket) -> bool:
        """Returns whether a stream of set-points that began with a ticket is no longer followed."""
        with self._changed:
            return ticket.number <= self._replaced or self._is_barred(ticket)

    def epoch(self, ticket: Ticket, timeout: float) -> int | None:
        """Returns the epoch that a request belongs to; None if that is not known within the time-out.

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
