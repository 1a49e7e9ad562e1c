"""Routers, and arms without hardware that answer `arm` and `stop`, as many as a test needs."""

import contextlib
import json
from contextlib import ExitStack
from typing import Any

import zenoh

from hyperbit.controller.network import session
from tests.endpoints import free_endpoint


class Router:
    def __init__(self, stack: ExitStack) -> None:
        self.endpoint = free_endpoint()
        self.start()
        stack.callback(self.end)

    def start(self) -> None:
        self._session: Any = zenoh.open(session.configuration("router", listen=self.endpoint))

    def end(self) -> None:
        self._session.close()

    def client(self, namespace: str = "") -> zenoh.Config:
        config = session.configuration("client", connect=self.endpoint)
        if namespace:
            config.insert_json5("namespace", json.dumps(namespace))
        return config


class PlayedArm:
    """An arm that exists as a Zenoh session.

    Attributes:
        answer: to `stop`; None: none.
    """

    def __init__(self, stack: ExitStack, config: zenoh.Config, name: str = "a") -> None:
        self.requests: list[str] = []
        self.answer: dict[str, Any] | None = {"accepted": True, "code": 0, "message": "stopped"}
        self._prefix, self._held, self._ended = f"hyperbit/{name}", list[zenoh.Query](), False
        self._session: Any = zenoh.open(config)
        stack.callback(self.end)
        self._declared: list[Any] = [
            self._session.declare_queryable(f"{self._prefix}/{key}", self._on_query) for key in ("arm", "stop", "goal")
        ]
        self._token: Any = self._session.liveliness().declare_token(f"{self._prefix}/alive")
        self._states: Any = self._session.declare_publisher(f"{self._prefix}/state")

    def end(self) -> None:
        if not self._ended:
            self._ended = True
            self._session.close()

    def publish(self, **fields: Any) -> None:
        state = {"mode": "ready", "reason": "holding", "simulated": True, "goal": None, "faults": [], **fields}
        self.publish_bytes(json.dumps(state).encode())

    def publish_bytes(self, payload: bytes) -> None:
        """Publishes a payload on `state`, unless the arm has ended."""
        with contextlib.suppress(zenoh.ZError):
            self._states.put(payload)

    def _on_query(self, query: zenoh.Query) -> None:
        key = str(query.key_expr).rpartition("/")[2]
        self.requests.append(key)
        answer = {"version": "9.9", "daemon": {"host": "here", "pid": 1}} if key == "arm" else self.answer
        if answer is None:
            self._held.append(query)  # it has no answer until its time is over
            return
        with query:
            query.reply(f"{self._prefix}/{key}", json.dumps(answer).encode())
