import contextlib
import logging
import threading
from collections import Counter
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import zenoh
import zenoh.ext

from hyperbit.controller.ros2.wire import attachments
from hyperbit.controller.ros2.wire.attachments import Attachment, BadAttachment
from hyperbit.controller.ros2.wire.cdr import MOST_BYTES, BadMessage, deserialize, serialize
from hyperbit.controller.ros2.wire.qos import History, Qos
from hyperbit.controller.ros2.wire.session import Session
from hyperbit.controller.ros2.wire.tokens import Token
from hyperbit.controller.ros2.wire.types import Types

HEARTBEAT = 0.5  # [s] between two reports of a publisher's last sample number, as in rmw_zenoh
log = logging.getLogger(__name__)


class Received(NamedTuple):
    message: Any  # its numbers may be NaN or infinite
    sequence: int  # number at its source
    source_time: int  # of sending [ns since 1970]
    gid: bytes  # of the source, 16 bytes; `Token.gid` of its token


class Dropped(Exception):
    """A message from the network cannot be used. `reason`: attachment, size or content."""

    def __init__(self, reason: str) -> None:
        super().__init__(reason)
        self.reason = reason


def receive(payload: zenoh.ZBytes | None, attachment: zenoh.ZBytes | None, name: str, types: Types) -> Received:
    """Decodes the payload of a sample, query or reply. Raises Dropped if it is no message of this type."""
    try:
        source = attachments.parse(None if attachment is None else attachment.to_bytes())
    except BadAttachment as error:
        log.debug("%s: %s", name, error)
        raise Dropped("attachment") from None
    if payload is not None and len(payload) > MOST_BYTES:
        raise Dropped("size")
    try:
        message = deserialize(b"" if payload is None else payload.to_bytes(), name, types)
    except BadMessage as error:
        log.debug("%s", error)
        raise Dropped("content") from None
    return Received(message, *source)


class Publisher:
    """Publishes messages on one topic. Thread-safe."""

    def __init__(self, session: Session, token: Token, key: str, name: str, types: Types) -> None:
        assert token.endpoint
        self.token = token
        self._name, self._types, self._gid = name, types, token.gid
        self._lock, self._sequence, self._time_ns = threading.Lock(), 0, session.computer.time_ns
        self._publisher = session.declare_publisher(key, **_publishing(token.endpoint.qos))
        self._token = session.zenoh.liveliness().declare_token(token.text)

    def publish(self, value: Any) -> None:
        """Publishes a message, or its fields by name; does nothing on a closed session. Raises BadMessage."""
        data = serialize(value, self._name, self._types)
        with self._lock:
            self._sequence += 1
            attachment = Attachment(self._sequence, self._time_ns(), self._gid).data
            with contextlib.suppress(zenoh.ZError):
                self._publisher.put(data, attachment=attachment)

    def close(self) -> None:
        """Ends the publisher; its transient-local messages are gone."""
        with contextlib.suppress(zenoh.ZError):  # the session is closed
            self._token.undeclare()  # type: ignore[no-untyped-call]
            self._publisher.undeclare()  # type: ignore[no-untyped-call]


class Subscriber:
    """Hands the messages of one topic to a callback, one after another, in a thread of Zenoh's.

    While the callback runs, up to 256 messages wait; then the session waits. `dropped` counts dropped messages by
    reason: attachment, size, content, or callback if it raised.
    """

    def __init__(
        self,
        session: Session,
        token: Token,
        key: str,
        name: str,
        callback: Callable[[Received], None],
        types: Types,
    ) -> None:
        assert token.endpoint
        self.token = token
        self.dropped: Counter[str] = Counter()  # changed by the one thread that calls back
        self._name, self._callback, self._types = name, callback, types
        self._subscriber = session.declare_subscriber(key, self._on_sample, **_subscribing(token.endpoint.qos))
        self._token = session.zenoh.liveliness().declare_token(token.text)

    def close(self) -> None:
        with contextlib.suppress(zenoh.ZError):
            self._token.undeclare()  # type: ignore[no-untyped-call]
            self._subscriber.undeclare()  # type: ignore[no-untyped-call]

    def _on_sample(self, sample: zenoh.Sample) -> None:
        try:
            self._callback(receive(sample.payload, sample.attachment, self._name, self._types))
        except Dropped as error:
            self.dropped[error.reason] += 1
        except Exception:
            self.dropped["callback"] += 1
            log.exception("the callback of %s failed", self.token.text)


def _publishing(qos: Qos) -> Mapping[str, Any]:
    """Returns rmw_zenoh's options of a Zenoh publisher."""
    keep_all = qos.reliable and qos.history is History.KEEP_ALL
    options: dict[str, Any] = {
        "congestion_control": zenoh.CongestionControl.BLOCK if keep_all else zenoh.CongestionControl.DROP,
        "reliability": zenoh.Reliability.RELIABLE if qos.reliable else zenoh.Reliability.BEST_EFFORT,
    }
    if qos.transient_local:
        options |= {"cache": zenoh.ext.CacheConfig(max_samples=qos.depth), "publisher_detection": True}
        if qos.reliable:
            detection = zenoh.ext.MissDetectionConfig(heartbeat=None, sporadic_heartbeat=HEARTBEAT)
            options["sample_miss_detection"] = detection
    return options


def _subscribing(qos: Qos) -> Mapping[str, Any]:
    """Returns rmw_zenoh's options of a Zenoh subscriber."""
    if not qos.transient_local:
        return {}
    history = zenoh.ext.HistoryConfig(detect_late_publishers=True, max_samples=qos.depth)
    options: dict[str, Any] = {"history": history, "subscriber_detection": True}
    if qos.reliable:
        options["recovery"] = zenoh.ext.RecoveryConfig(periodic_queries=None, heartbeat=True)
    return options
