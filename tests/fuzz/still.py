"""A Zenoh session without a network: tests call what was declared."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from types import SimpleNamespace
from typing import Any, NamedTuple

import zenoh

ROOM = "/dev/shm" if os.access("/dev/shm", os.W_OK) else None  # of small folders
Take = Callable[[str, bytes], None]  # a reader of a key, or a file's name, and bytes


class Sample(NamedTuple):
    """A sample; also the content of a reply."""

    key_expr: str
    payload: zenoh.ZBytes
    attachment: zenoh.ZBytes | None = None
    kind: zenoh.SampleKind = zenoh.SampleKind.PUT


class Reply(NamedTuple):
    ok: Sample | None


class Query:
    """A query that keeps its replies."""

    def __init__(self, key_expr: str, payload: bytes) -> None:
        self.key_expr, self.payload, self.attachment = key_expr, zenoh.ZBytes(payload), None
        self.replies: list[bytes] = []

    def __enter__(self) -> Query:
        return self

    def __exit__(self, *_: object) -> None:
        pass

    def reply(self, key: str, data: bytes, **_: Any) -> None:
        self.replies.append(data)


class StillSession:
    """Keeps the callbacks of subscribers and queryables by key. `answer` is the reply to each query."""

    def __init__(self) -> None:
        self.subscribers: dict[str, Callable[[Any], None]] = {}
        self.queryables: dict[str, Callable[[Any], None]] = {}
        self.answer = b"{}"
        nothing = lambda *_, **__: None  # noqa: E731
        self._declared = SimpleNamespace(matching_status=SimpleNamespace(matching=True), undeclare=nothing, put=nothing)
        self.put = self.close = nothing

    def liveliness(self) -> StillSession:
        return self

    def declare_subscriber(self, key: str, callback: Any, **_: Any) -> Any:
        self.subscribers[key] = getattr(callback, "callback", callback)
        return self._declared

    def declare_queryable(self, key: str, callback: Any, **_: Any) -> Any:
        self.queryables[key] = getattr(callback, "callback", callback)
        return self._declared

    def declare_token(self, key: str) -> Any:
        return self._declared

    def declare_publisher(self, key: str, **_: Any) -> Any:
        return self._declared

    def get(self, key: str, handler: Callable[[Any], None] | None = None, **_: Any) -> Iterator[Reply]:
        reply = Reply(Sample(key, zenoh.ZBytes(self.answer)))
        if handler is not None:
            handler(reply)
        return iter([reply])
