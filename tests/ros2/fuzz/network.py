"""A narrow stand-in for Zenoh: what the bridge declares is called directly, and what it sends is looked at."""

import itertools
import json
from collections import deque
from collections.abc import Callable
from typing import Any, NamedTuple

import zenoh

from tests.ros2.judge.actions import Wrong
from tests.ros2.judge.judge import Judge

TOKENS = "tokens"  # in place of a name: what hears of all nodes and endpoints


class Sample(NamedTuple):
    """A sample, as far as the bridge reads it."""

    payload: zenoh.ZBytes
    attachment: zenoh.ZBytes | None


class TokenSample(NamedTuple):
    """A token that has come or gone, as far as the bridge reads it."""

    key_expr: str
    kind: zenoh.SampleKind


class Query:
    """A query, as far as the bridge uses it; it is replied to at most once."""

    def __init__(self, payload: bytes, attachment: bytes | None, on_reply: Callable[[bytes], None]) -> None:
        self.payload, self._on_reply, self.replied = zenoh.ZBytes(payload), on_reply, False
        self.attachment = None if attachment is None else zenoh.ZBytes(attachment)

    def __enter__(self) -> "Query":
        return self

    def __exit__(self, *_: object) -> None:
        pass

    def drop(self) -> None:
        pass

    def reply(self, key: str, data: bytes, attachment: bytes) -> None:
        if self.replied or len(attachment) != 33:
            raise Wrong(f"a second reply, or one without attachment, on {key}")
        self.replied = True
        self._on_reply(data)


class Declared:
    """A declaration that can be undone, and a publisher."""

    def __init__(self, undo: Callable[[], object], put: Callable[[bytes], None] = lambda data: None) -> None:
        self.undeclare, self._put = undo, put

    def put(self, data: bytes, attachment: bytes) -> None:
        if len(attachment) != 33:
            raise Wrong("a message without attachment")
        self._put(data)


class Network:
    """The session of the wire and that of Zenoh in one: everything that is declared, by name below the namespace."""

    zid = "f00d"

    def __init__(self, judge: Judge) -> None:
        self._judge = judge
        self.handlers: dict[str, Callable[[Any], None]] = {}
        self.tokens: set[str] = set()
        self.life = 0  # number of kills; what is left of a killed bridge does nothing
        self.words = 0
        self.published = deque[str](maxlen=100)  # names of topics
        self._numbers = itertools.count()

    @property
    def zenoh(self) -> "Network":
        return self

    def liveliness(self) -> "Network":
        return self

    def next_number(self) -> str:
        return str(next(self._numbers))

    def kill(self) -> None:
        self.life += 1
        self.handlers.clear()
        self.tokens.clear()

    def declare_token(self, text: str) -> Declared:
        life = self.life
        self.tokens.add(text)

        def undo() -> None:
            self.tokens.discard(text)
            if "/NN/" in text and life == self.life:
                self._judge.receive_close()

        return Declared(undo)

    def declare_queryable(self, key: str, handler: Callable[[Any], None], complete: bool) -> Declared:
        return self.declare_subscriber(key, handler)

    def declare_subscriber(self, key: str, handler: Callable[[Any], None], history: bool = False) -> Declared:
        if "*" in key and not history:
            raise Wrong(f"messages of a wrong type or hash would be accepted on {key}")
        name = TOKENS if history else below(key)
        self.handlers[name] = handler
        return Declared(lambda: self.handlers.pop(name) if self.handlers.get(name) == handler else None)

    def declare_publisher(self, key: str, **_: Any) -> Declared:
        name, life = below(key), self.life

        def put(data: bytes) -> None:
            if life != self.life:
                return
            self.published.append(name)
            self._judge.receive_message(name, data)
            if name == "rosout":
                self.receive_words(data)

        return Declared(lambda: None, put)

    def receive_words(self, data: bytes) -> None:
        self.words += 1


def below(key: str) -> str:
    return "/".join(key.split("/")[2:-2]) or key.split("/")[1]


def strict_json(payload: object) -> bytes:
    """Returns JSON in which each number is one."""
    try:
        return json.dumps(payload, allow_nan=False).encode()
    except (ValueError, TypeError) as error:
        raise Wrong(f"the daemon would be sent {error}: {str(payload)[:300]}") from None
