import contextlib
import itertools
import logging
import threading
from collections import Counter
from collections.abc import Callable
from typing import Any

import zenoh

from hyperbit.controller.ros2.wire import attachments
from hyperbit.controller.ros2.wire.attachments import Attachment, BadAttachment
from hyperbit.controller.ros2.wire.cdr import serialize
from hyperbit.controller.ros2.wire.session import Session
from hyperbit.controller.ros2.wire.tokens import Token
from hyperbit.controller.ros2.wire.topics import Dropped, Received, receive
from hyperbit.controller.ros2.wire.types import Types

REFUSED = {"action_msgs/srv/CancelGoal": {"return_code": 1}}  # responses that refuse, unless 0 does
MOST_OPEN = 64  # requests of a service that wait for their reply
log = logging.getLogger(__name__)


class NoReply(TimeoutError):
    """No service answered in time."""


class Request:
    """One request of a service's client. Any thread replies to it once, now or later."""

    def __init__(self, received: Received, reply: Callable[[Any], None]) -> None:
        self.received = received  # the request's message and its sender
        self.message = received.message
        self._reply = reply

    def reply(self, value: Any) -> None:
        """Sends the response, or the response with these fields by name. Further replies are ignored.

        Raises BadMessage if a field is missing, or its value does not fit. The request stays open then.
        """
        self._reply(value)


class Service:
    """Hands the requests of one service to a handler, one after another, in a thread of Zenoh's.

    Attributes:
        dropped: number of requests dropped, by reason: attachment, size, content, open (too many were open) or callback
            (the handler raised before it replied). A dropped request with an attachment gets an empty response.
    """

    def __init__(
        self,
        session: Session,
        token: Token,
        key: str,
        name: str,
        handler: Callable[[Request], None],
        types: Types,
    ) -> None:
        self.token = token
        self.dropped: Counter[str] = Counter()  # changed by the one thread that calls back
        self._key, self._name, self._handler, self._types = key, name, handler, types
        self._lock, self._numbers = threading.Lock(), itertools.count()
        self._open: dict[int, zenoh.Query] = {}
        self._time_ns = session.computer.time_ns
        # Clients of rmw_zenoh query only services that are declared complete.
        self._queryable = session.zenoh.declare_queryable(key, self._on_query, complete=True)
        self._token = session.zenoh.liveliness().declare_token(token.text)

    @property
    def open(self) -> int:
        return len(self._open)

    def close(self) -> None:
        """Ends the service; open requests get no reply."""
        with contextlib.suppress(zenoh.ZError):
            self._token.undeclare()  # type: ignore[no-untyped-call]
            self._queryable.undeclare()  # type: ignore[no-untyped-call]
        with self._lock:
            self._open.clear()

    def _on_query(self, query: zenoh.Query) -> None:
        number = next(self._numbers)
        try:
            received = receive(query.payload, query.attachment, f"{self._name}_Request", self._types)
            with self._lock:
                if len(self._open) >= MOST_OPEN:
                    raise Dropped("open")
                self._open[number] = query
            self._handler(Request(received, lambda value: self._reply(number, received, value)))
        except Dropped as error:
            self.dropped[error.reason] += 1
            self._decline(query)
        except Exception:
            with self._lock:
                replied = self._open.pop(number, None) is None
            if not replied:
                self.dropped["callback"] += 1
                self._decline(query)
            log.exception("the handler of %s failed", self.token.text)

    def _decline(self, query: zenoh.Query) -> None:
        """Replies to a request that is not served, because a client of rmw_zenoh waits for a reply without end.

        The response is empty: its numbers are 0, so that nothing is accepted.
        """
        with query, contextlib.suppress(BadAttachment, zenoh.ZError):
            source = attachments.parse(None if query.attachment is None else query.attachment.to_bytes())
            data = serialize(REFUSED.get(self._name, {}), f"{self._name}_Response", self._types)
            attachment = Attachment(source.sequence, self._time_ns(), source.gid).data
            query.reply(self._key, data, attachment=attachment)

    def _reply(self, number: int, received: Received, value: Any) -> None:
        data = serialize(value, f"{self._name}_Response", self._types)
        with self._lock:
            query = self._open.pop(number, None)
        if query is None:
            return
        attachment = Attachment(received.sequence, self._time_ns(), received.gid).data
        with contextlib.suppress(zenoh.ZError), query:  # the client or the session is gone
            query.reply(self._key, data, attachment=attachment)


class Client:
    """Calls one service. Thread-safe, but not for a callback, since it waits."""

    def __init__(self, session: Session, token: Token, key: str, name: str, types: Types) -> None:
        self.token = token
        self._session, self._key, self._name, self._types = session, key, name, types
        self._numbers, self._gid = itertools.count(1), token.gid
        self._token = session.zenoh.liveliness().declare_token(token.text)

    def call(self, value: Any, timeout: float = 10.0) -> Received:
        """Returns the first response to a request; several services of one name all get it.

        Args:
            value: the request, or its fields by name.
            timeout: longest time to wait [s].

        Raises:
            BadMessage: a field is missing, or its value does not fit.
            NoReply: no valid response came.
        """
        data = serialize(value, f"{self._name}_Request", self._types)
        replies = self._session.zenoh.get(
            self._key,
            payload=data,
            attachment=Attachment(next(self._numbers), self._session.computer.time_ns(), self._gid).data,
            target=zenoh.QueryTarget.ALL_COMPLETE,
            consolidation=zenoh.ConsolidationMode.NONE,
            timeout=timeout,
        )
        for reply in replies:
            if reply.ok is not None:
                with contextlib.suppress(Dropped):
                    return receive(reply.ok.payload, reply.ok.attachment, f"{self._name}_Response", self._types)
        raise NoReply(f"no service answered on {self._key} within {timeout:g} s")

    def close(self) -> None:
        with contextlib.suppress(zenoh.ZError):
            self._token.undeclare()  # type: ignore[no-untyped-call]
