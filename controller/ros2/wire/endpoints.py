"""What a node has on a topic or service: publishers, subscribers, services and clients."""

import contextlib
import itertools
import logging
import threading
from collections import Counter
from collections.abc import Callable
from typing import Any, NamedTuple

import zenoh
import zenoh.ext

from hyperbit.controller.ros2.wire import attachments, names, qos
from hyperbit.controller.ros2.wire.attachments import Attachment, BadAttachment
from hyperbit.controller.ros2.wire.cdr import MOST_BYTES, BadMessage, deserialize, serialize
from hyperbit.controller.ros2.wire.qos import Qos
from hyperbit.controller.ros2.wire.session import Session
from hyperbit.controller.ros2.wire.tokens import EndpointToken, Kind, Token
from hyperbit.controller.ros2.wire.types import Types

HEARTBEAT = 0.5  # [s] between two reports of a publisher's last sample number, as in rmw_zenoh
MOST_OPEN = 64  # requests of a service that wait for their reply
REFUSED = {"action_msgs/srv/CancelGoal": {"return_code": 1}}  # responses that refuse, unless 0 does
log = logging.getLogger(__name__)


class Place(NamedTuple):
    """Where the endpoints of a node are."""

    session: Session
    types: Types  # of the node's distribution
    node: Token


class Received(NamedTuple):
    message: Any  # its numbers may be NaN or infinite
    sequence: int  # number at its source
    source_time: int  # of sending [ns since 1970]
    gid: bytes  # of the source, 16 bytes; `Token.gid` of its token


class Dropped(Exception):
    """A message from the network cannot be used. `reason`: attachment, size, content or open."""

    def __init__(self, reason: str) -> None:
        super().__init__(reason)
        self.reason = reason


class NoReply(TimeoutError):
    """No service answered in time."""


class Endpoint:
    """An endpoint of a node, with its token.

    Attributes:
        dropped: number of messages dropped, by reason: attachment, size, content, callback (it raised; of a service:
            before it replied), or open (too many requests of a service were open).

    Args:
        name: absolute, or relative to namespace ("tf") or node ("~/state").
        type_name: such as std_msgs/msg/String.

    Raises:
        BadName: the name is not allowed.
        UnknownType: the type is not known.
    """

    def __init__(self, place: Place, kind: Kind, name: str, type_name: str, setting: Qos = qos.DEFAULT) -> None:
        absolute = names.resolve(name, place.node.namespace, place.node.node)
        type_hash = place.types.hash(type_name)
        described = EndpointToken(absolute, names.dds_type(type_name), type_hash, setting.text)
        self.token = place.node._replace(id=place.session.next_number(), kind=kind, endpoint=described)
        self.dropped: Counter[str] = Counter()  # changed by the one thread that calls back
        self._place, self._type, self._time_ns = place, type_name, place.session.computer.time_ns
        self._key = names.data_key(place.node.domain, absolute, type_name, type_hash)
        self._declared: list[Any] = []

    def close(self) -> None:
        """Ends the endpoint: messages that a latched publisher keeps are gone, and open requests get no reply."""
        with contextlib.suppress(zenoh.ZError):  # the session is closed
            while self._declared:
                self._declared.pop().undeclare()

    def _declare(self, *declared: Any) -> None:
        """Takes what Zenoh has to undeclare, and declares the token last: others look for what it promises."""
        self._declared += declared
        self._declared.append(self._place.session.zenoh.liveliness().declare_token(self.token.text))

    def _receive(self, payload: zenoh.ZBytes | None, attachment: zenoh.ZBytes | None, part: str = "") -> Received:
        """Decodes a sample, query or reply; `part` of the type, such as _Request. Raises Dropped."""
        try:
            source = attachments.parse(None if attachment is None else attachment.to_bytes())
        except BadAttachment as error:
            log.debug("%s: %s", self._type, error)
            raise Dropped("attachment") from None
        if payload is not None and len(payload) > MOST_BYTES:
            raise Dropped("size")
        try:
            data = b"" if payload is None else payload.to_bytes()
            message = deserialize(data, self._type + part, self._place.types)
        except BadMessage as error:
            log.debug("%s", error)
            raise Dropped("content") from None
        return Received(message, *source)


class Publisher(Endpoint):
    """Publishes messages on one topic. Thread-safe."""

    def __init__(self, place: Place, topic: str, type_name: str, setting: Qos) -> None:
        super().__init__(place, Kind.PUBLISHER, topic, type_name, setting)
        self._lock, self._numbers, self._gid = threading.Lock(), itertools.count(1), self.token.gid
        options: dict[str, Any] = {  # rmw_zenoh's
            "congestion_control": zenoh.CongestionControl.DROP,
            "reliability": zenoh.Reliability.RELIABLE if setting.reliable else zenoh.Reliability.BEST_EFFORT,
        }
        if setting.latched:
            options |= {"cache": zenoh.ext.CacheConfig(max_samples=setting.depth), "publisher_detection": True}
            if setting.reliable:
                detection = zenoh.ext.MissDetectionConfig(heartbeat=None, sporadic_heartbeat=HEARTBEAT)
                options["sample_miss_detection"] = detection
        self._publisher = place.session.declare_publisher(self._key, **options)
        self._declare(self._publisher)

    def publish(self, value: Any) -> None:
        """Publishes a message, or its fields by name; does nothing on a closed session. Raises BadMessage."""
        data = serialize(value, self._type, self._place.types)
        with self._lock, contextlib.suppress(zenoh.ZError):
            attachment = Attachment(next(self._numbers), self._time_ns(), self._gid).data
            self._publisher.put(data, attachment=attachment)


class Subscriber(Endpoint):
    """Hands the messages of one topic to a callback, one after another, in a thread of Zenoh's.

    While the callback runs, up to 256 messages wait; then the session waits.
    """

    def __init__(
        self, place: Place, topic: str, type_name: str, callback: Callable[[Received], None], setting: Qos
    ) -> None:
        super().__init__(place, Kind.SUBSCRIBER, topic, type_name, setting)
        self._callback = callback
        options: dict[str, Any] = {}  # rmw_zenoh's
        if setting.latched:
            history = zenoh.ext.HistoryConfig(detect_late_publishers=True, max_samples=setting.depth)
            options = {"history": history, "subscriber_detection": True}
            if setting.reliable:
                options["recovery"] = zenoh.ext.RecoveryConfig(periodic_queries=None, heartbeat=True)
        self._declare(place.session.declare_subscriber(self._key, self._on_sample, **options))

    def _on_sample(self, sample: zenoh.Sample) -> None:
        try:
            self._callback(self._receive(sample.payload, sample.attachment))
        except Dropped as error:
            self.dropped[error.reason] += 1
        except Exception:
            self.dropped["callback"] += 1
            log.exception("the callback of %s failed", self.token.text)


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


class Service(Endpoint):
    """Hands the requests of one service to a handler, one after another, in a thread of Zenoh's.

    A dropped request with an attachment gets an empty response.
    """

    def __init__(self, place: Place, name: str, type_name: str, handler: Callable[[Request], None]) -> None:
        super().__init__(place, Kind.SERVICE, name, type_name)
        self._handler = handler
        self._lock, self._numbers = threading.Lock(), itertools.count()
        self._open: dict[int, zenoh.Query] = {}
        # Clients of rmw_zenoh query only services that are declared complete.
        self._declare(place.session.zenoh.declare_queryable(self._key, self._on_query, complete=True))

    @property
    def open(self) -> int:
        """Number of requests that wait for a reply."""
        return len(self._open)

    def close(self) -> None:
        super().close()
        with self._lock:
            self._open.clear()

    def _on_query(self, query: zenoh.Query) -> None:
        number = next(self._numbers)
        try:
            received = self._receive(query.payload, query.attachment, "_Request")
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
        try:
            source = attachments.parse(None if query.attachment is None else query.attachment.to_bytes())
        except BadAttachment:
            with query:  # ends it without a reply
                return
        data = serialize(REFUSED.get(self._type, {}), f"{self._type}_Response", self._place.types)
        self._send(query, data, source.sequence, source.gid)

    def _reply(self, number: int, received: Received, value: Any) -> None:
        data = serialize(value, f"{self._type}_Response", self._place.types)
        with self._lock:
            query = self._open.pop(number, None)
        if query is not None:
            self._send(query, data, received.sequence, received.gid)

    def _send(self, query: zenoh.Query, data: bytes, sequence: int, gid: bytes) -> None:
        attachment = Attachment(sequence, self._time_ns(), gid).data
        with contextlib.suppress(zenoh.ZError), query:  # the client or the session is gone
            query.reply(self._key, data, attachment=attachment)


class Client(Endpoint):
    """Calls one service. Thread-safe, but not for a callback, since it waits."""

    def __init__(self, place: Place, name: str, type_name: str) -> None:
        super().__init__(place, Kind.CLIENT, name, type_name)
        self._numbers, self._gid = itertools.count(1), self.token.gid
        self._declare()

    def call(self, value: Any, timeout: float = 10.0) -> Received:
        """Returns the first response to a request; several services of one name all get it.

        Args:
            value: the request, or its fields by name.
            timeout: longest time to wait [s].

        Raises:
            BadMessage: a field is missing, or its value does not fit.
            NoReply: no valid response came.
        """
        data = serialize(value, f"{self._type}_Request", self._place.types)
        replies = self._place.session.zenoh.get(
            self._key,
            payload=data,
            attachment=Attachment(next(self._numbers), self._time_ns(), self._gid).data,
            target=zenoh.QueryTarget.ALL_COMPLETE,
            consolidation=zenoh.ConsolidationMode.NONE,
            timeout=timeout,
        )
        for reply in replies:
            if reply.ok is not None:
                with contextlib.suppress(Dropped):
                    return self._receive(reply.ok.payload, reply.ok.attachment, "_Response")
        raise NoReply(f"no service answered on {self._key} within {timeout:g} s")
