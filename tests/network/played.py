"""Routers, and arms without hardware that record requests and answer them at once, as many as a test needs."""

import contextlib
import json
import threading
from contextlib import ExitStack
from typing import Any

import zenoh

from hyperbit.controller.network import session
from tests import told
from tests.endpoints import free_endpoint
from tests.waiting import PATIENCE

ARM = "planar16"
KEYS = ("arm", "plan", "goal", "jog", "stop", "cancel", "reset", "degrade", "obstacles", "fault", "answer")


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
        told: answer to `arm`.
        asked: key and payload of each request but `arm`.
        answer: to these requests; None: none, until their time is over.
        gate: event that answers to `plan` wait for.
        planned, homing: fields of an answer to `plan`.
    """

    def __init__(self, stack: ExitStack, config: zenoh.Config, name: str = "a", prefix: str = "hyperbit") -> None:
        self.told = told.described(name=name, version="9.9", daemon={"host": "here", "pid": 1})
        self.asked: list[tuple[str, dict[str, Any]]] = []
        self.answer: dict[str, Any] | None = {"accepted": True, "code": 0, "message": "stopped"}
        self.planned: dict[str, Any] = {}
        self.homing: list[str] = []
        self.gate = threading.Event()
        self.gate.set()
        self._prefix, self._held, self._ended = f"{prefix}/{name}", list[zenoh.Query](), False
        self._latest, self._order = told.state(), threading.Lock()
        self.session: Any = zenoh.open(config)
        stack.callback(self.end)
        self._declared = [self.session.declare_queryable(f"{self._prefix}/{key}", self._on_query) for key in KEYS]
        self._token = self.session.liveliness().declare_token(f"{self._prefix}/alive")
        self._states = self.session.declare_publisher(f"{self._prefix}/state")

    def commands(self) -> list[str]:
        return [key for key, _ in self.asked]

    def state(self, **fields: Any) -> dict[str, Any]:
        """Publishes a state of an arm that is ready, with these fields."""
        with self._order:
            self._latest = told.state(**{"simulated": False, "stamp": 0.0, **fields})
            self.put("state", self._latest)
        return self._latest

    def repeat(self) -> None:
        """Publishes the latest state again, as a daemon does whose arm stands."""
        with self._order:
            self.put("state", self._latest)

    def put(self, key: str, payload: Any) -> None:
        """Publishes JSON or bytes, unless the arm has ended."""
        data = payload if isinstance(payload, bytes) else json.dumps(payload).encode()
        with contextlib.suppress(zenoh.ZError):
            if key == "state":
                self._states.put(data)
            else:
                self.session.put(f"{self._prefix}/{key}", data)

    def die(self) -> None:
        """Removes the liveliness token."""
        self._token.undeclare()

    def end(self) -> None:
        self.gate.set()
        if not self._ended:
            self._ended = True
            self.session.close()

    def _on_query(self, query: zenoh.Query) -> None:
        key = str(query.key_expr).rpartition("/")[2]
        payload = json.loads(query.payload.to_bytes()) if query.payload else {}
        if key == "arm":
            wanted = payload.get("with", [])
            answer = {k: v for k, v in self.told.items() if k in wanted or k not in ("drawing", "running")}
        else:
            self.asked.append((key, payload))
            if self.answer is None:
                self._held.append(query)  # it has no answer until its time is over
                return
            answer = self.answer
        if key == "plan":
            self.gate.wait(PATIENCE)
            point = {"configuration": "1" * 16, "between": False, **self.planned}
            answer = {**answer, "waypoints": [point], "switches": 3, "homing": self.homing}
        if key == "goal":
            answer = {**answer, "id": payload.get("id", "")}
        with query:
            query.reply(f"{self._prefix}/{key}", json.dumps(answer).encode())


def listening(stack: ExitStack, endpoint: str, prefix: str = "hyperbit") -> PlayedArm:
    """Returns the arm of the paper, at an endpoint of its own."""
    return PlayedArm(stack, session.configuration("peer", listen=endpoint), ARM, prefix)
