"""A narrow stand-in for Zenoh: what the bridge declares is called directly, and what it sends is looked at."""

import itertools
import json
import struct
from collections import deque
from collections.abc import Callable
from typing import Any, NamedTuple

import zenoh

LONGEST_WORDS = 10_000  # bytes of a sentence on /rosout
TOKENS = "tokens"  # in place of a name: what hears of all nodes and endpoints
TERMINAL = (4, 5, 6)  # succeeded, canceled, aborted
FIRST, NEXT = struct.Struct("<16siIb"), struct.Struct("<16s3xiIb")  # goals of a GoalStatusArray, the first is aligned


class Wrong(AssertionError):
    """The bridge has broken a rule."""


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
        self._undo, self._put = undo, put

    def undeclare(self) -> None:
        self._undo()

    def put(self, data: bytes, attachment: bytes) -> None:
        if len(attachment) != 33:
            raise Wrong("a message without attachment")
        self._put(data)


class GoalRecord:
    """Accepted goals of the actions by name of the server and id: each ends once, and has one result."""

    def __init__(self) -> None:
        self.accepted = self.ended = 0
        self.open: set[tuple[str, bytes]] = set()
        self._results: dict[tuple[str, bytes], bytes] = {}

    def receive_acceptance(self, server: str, uuid: bytes) -> None:
        if (server, uuid) in self.open:
            raise Wrong(f"goal {uuid.hex()} is accepted twice")
        self.accepted += 1
        self.open.add((server, uuid))
        self._results.pop((server, uuid), None)

    def receive_result(self, server: str, uuid: bytes, reply: bytes) -> None:
        if reply[4] not in TERMINAL:
            if (server, uuid) in self.open:
                raise Wrong(f"goal {uuid.hex()} is active, and its result has status {reply[4]}")
        elif self._results.setdefault((server, uuid), reply) != reply:
            raise Wrong(f"goal {uuid.hex()} has two results")

    def receive_status(self, server: str, data: bytes) -> None:
        body = data[8:]
        goals = [*FIRST.iter_unpack(body[: FIRST.size]), *NEXT.iter_unpack(body[FIRST.size :])]
        states = {uuid: status for uuid, _, _, status in goals}
        for key in [it for it in self.open if it[0] == server]:
            if key[1] not in states:
                raise Wrong(f"goal {key[1].hex()} has gone without a result")
            if states[key[1]] in TERMINAL:
                self.open.discard(key)
                self.ended += 1


class Network:
    """The session of the wire and that of Zenoh in one: everything that is declared, by name below the namespace."""

    zid = "f00d"

    def __init__(self) -> None:
        self.handlers: dict[str, Callable[[Any], None]] = {}
        self.tokens: set[str] = set()
        self.goals = GoalRecord()
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

    def declare_token(self, text: str) -> Declared:
        self.tokens.add(text)
        return Declared(lambda: self.tokens.discard(text))

    def declare_queryable(self, key: str, handler: Callable[[Any], None], complete: bool) -> Declared:
        return self.declare_subscriber(key, handler)

    def declare_subscriber(self, key: str, handler: Callable[[Any], None], history: bool = False) -> Declared:
        if "*" in key and not history:
            raise Wrong(f"messages of a wrong type or hash would be accepted on {key}")
        name = TOKENS if history else below(key)
        self.handlers[name] = handler
        return Declared(lambda: self.handlers.pop(name) if self.handlers.get(name) == handler else None)

    def declare_publisher(self, key: str, **_: Any) -> Declared:
        name = below(key)
        if name.endswith("_action/status"):
            server = name.removesuffix("status")
            return Declared(lambda: None, lambda data: self.goals.receive_status(server, data))
        if "/rosout/" in key:
            return Declared(lambda: None, lambda data: self.receive_words(data))
        return Declared(lambda: None, lambda data: self.published.append(name))

    def receive_words(self, data: bytes) -> None:
        """Checks a sentence."""
        self.words += 1
        if len(data) > LONGEST_WORDS:
            raise Wrong(f"a sentence of {len(data)} bytes on /rosout")


def below(key: str) -> str:
    """Returns the name below domain and namespace in a key."""
    return "/".join(key.split("/")[2:-2])


def strict_json(payload: object) -> bytes:
    """Returns JSON in which each number is one."""
    try:
        return json.dumps(payload, allow_nan=False).encode()
    except (ValueError, TypeError) as error:
        raise Wrong(f"the daemon would be sent {error}: {str(payload)[:300]}") from None
