"""A server with a planner that only remembers requests, on real Zenoh sessions over loopback TCP."""

import json
import socket
import threading
from collections.abc import Callable, Collection, Iterator
from contextlib import ExitStack
from typing import Any

import pytest
import zenoh

from controller.gateway import session
from controller.gateway.client import Client
from controller.gateway.outbox import Outbox
from controller.gateway.repeated_goals import RepeatedGoals
from controller.gateway.server import Server
from controller.planning.core.messages import Payload, Reply, done, refused
from tests.waiting import PATIENCE, eventually

ARM = "a"


class FakePlanning:
    """Remembers requests and answers them at once, or on demand while `holding`.

    Attributes:
        heard: key and payload of each request.
        waiting: answers that wait.
    """

    def __init__(self) -> None:
        self.heard: list[tuple[str, bytes]] = []
        self.holding = threading.Event()
        self.waiting: list[tuple[Reply, Payload]] = []
        self.receive: dict[str, Callable[[], bytes | None]] = {}

    def _take(self, key: str, payload: bytes, reply: Reply, answer: Payload) -> None:
        self.heard.append((key, payload))
        if self.holding.is_set():
            self.waiting.append((reply, answer))
        else:
            reply(answer)

    def goal(self, payload: bytes, reply: Reply) -> None:
        try:
            goal = json.loads(payload)
            known = goal.get("id") if isinstance(goal, dict) else None
            answer: Payload = {**done("accepted"), "id": known or "made-up"}
            if known == "far":
                answer = refused(-5, "out of reach", known)
        except ValueError as error:
            answer = refused(-1, f"goal is not JSON: {error}")
        self._take("goal", payload, reply, answer)

    def plan(self, payload: bytes, reply: Reply) -> None:
        self._take("plan", payload, reply, done("planned"))

    def jog(self, payload: bytes, reply: Reply) -> None:
        if payload == b'"a defect"':
            raise RuntimeError("a defect")
        self._take("jog", payload, reply, done("switched"))

    def cancel(self, reply: Reply) -> None:
        self._take("cancel", b"", reply, done("canceled"))

    def stop(self, reply: Reply) -> None:
        self._take("stop", b"", reply, done("stopped"))

    def reset(self, reply: Reply) -> None:
        self._take("reset", b"", reply, done("reset"))

    def degrade(self, payload: bytes, reply: Reply) -> None:
        self._take("degrade", payload, reply, refused(-1, "no such actuator"))

    def obstacles(self, payload: bytes, reply: Reply) -> None:
        self._take("obstacles", payload, reply, done("kept out of"))

    def setpoints(self, receive: Callable[[], bytes | None]) -> None:
        self.receive["setpoint"] = receive

    def measured_tips(self, receive: Callable[[], bytes | None]) -> None:
        self.receive["measured_tip"] = receive

    def description(self, wanted: Collection[str] = ()) -> Payload:
        return {"name": ARM, "dimension": 2, **{key: {} for key in wanted}}


class Gateway:
    """A server of one arm, and its clients' sessions; all are closed after the test."""

    def __init__(self, stack: ExitStack, endpoint: str) -> None:
        self._stack, self.endpoint = stack, endpoint
        self.planning, self.goals = FakePlanning(), RepeatedGoals()
        self.session = stack.enter_context(zenoh.open(session.configuration("peer", listen=endpoint)))
        self.outbox = Outbox(self.session, f"hyperbit/{ARM}")
        stack.callback(self.outbox.close)
        self.server = self.serve()
        stack.callback(lambda: self.server.close())

    def serve(self, *, tracker: bool = True) -> Server:
        return Server(self.session, ARM, self.planning, self.outbox, self.goals, tracker=tracker)

    def other(self) -> zenoh.Session:
        """A session of a client."""
        return self._stack.enter_context(zenoh.open(session.configuration("client", connect=self.endpoint)))

    def client(self) -> Client:
        client = Client(self.other(), ARM, self.other)
        self._stack.callback(client.close)
        return client

    def results(self) -> list[dict[str, Any]]:
        """The messages on `result` from now on."""
        heard: list[dict[str, Any]] = []
        self.client().subscribe("result", heard.append)
        self.reached()
        return heard

    def reached(self) -> None:
        """Waits until a new client's declarations have reached the server's session."""
        eventually(lambda: self.client().request("arm", timeout=PATIENCE))


@pytest.fixture
def endpoint() -> str:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        return f"tcp/127.0.0.1:{free.getsockname()[1]}"


@pytest.fixture
def gateway(endpoint: str) -> Iterator[Gateway]:
    with ExitStack() as stack:
        yield Gateway(stack, endpoint)
