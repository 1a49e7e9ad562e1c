"""A server with a planner that only remembers requests, on real Zenoh sessions over loopback TCP."""

import itertools
import json
import sqlite3
import threading
import time
from collections.abc import Collection, Iterator
from contextlib import ExitStack
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import pytest
import zenoh
from msgspec.structs import replace

from hyperbit.controller.gateway.arrivals import Clocks, RepeatedGoals, Reply
from hyperbit.controller.gateway.outbox import Outbox
from hyperbit.controller.gateway.poses import Poses
from hyperbit.controller.gateway.server import GatewayParts, Server
from hyperbit.controller.messages.arm import Density, Description, Structure
from hyperbit.controller.messages.goals import Answer, done, refused
from hyperbit.controller.motion.decoding.goal import GoalMessage, parse
from hyperbit.controller.motion.decoding.requests import DegradeMessage
from hyperbit.controller.network import session
from hyperbit.controller.network.client import Client
from hyperbit.controller.planning.core.events import (
    Arrival,
    LiveArm,
    Message,
    SetpointArrived,
    TipArrived,
)
from hyperbit.controller.planning.loop import Mailbox
from hyperbit.controller.planning.planner import decode_cancel
from hyperbit.controller.refusals.reasons import Reason
from hyperbit.controller.refusals.refusal import Refusal
from tests.endpoints import free_endpoint
from tests.waiting import PATIENCE, eventually

ARM = "a"
PREFIX = f"hyperbit/{ARM}"
GOAL = b'{"id": "x", "waypoints": []}'
FAR = Refusal(Reason.OUT_OF_REACH, where="waypoint 1, position", position="9, 9", turned="", nearest="4 is the limit")
NO_ACTUATOR = Refusal(Reason.UNKNOWN_ACTUATOR, field="actuator", actuator="9.left", first="1.left", last="8.right")


class FakePlanner:
    """Remembers requests and answers them at once, or on demand while `holding`.

    Attributes:
        heard: key and message of each request.
        decoded: keys of the payloads that were decoded.
    """

    def __init__(self) -> None:
        self.heard: list[tuple[str, Message]] = []
        self.arrivals: list[int] = []
        self._numbers = itertools.count(1)
        self.decoded: list[str] = []
        self.holding = threading.Event()
        self.waiting: list[tuple[Reply, Any]] = []
        self.setpoints, self.tips = Mailbox(SetpointArrived), Mailbox(TipArrived)
        self.receive = {"setpoint": self.setpoints.take, "measured_tip": self.tips.take}
        self.tracker = True
        self.loop = self.decoder = self

    def decode(self, key: str, payload: bytes) -> Message:
        self.decoded.append(key)
        match key:
            case "goal" | "plan":
                return parse(payload)
            case "jog" if payload.startswith(b"{"):
                return json.loads(payload).get("actuators")
            case "degrade" if payload.startswith(b"{"):
                fields = json.loads(payload)
                return DegradeMessage(fields.get("actuator"), fields.get("state"))
            case "cancel":
                return decode_cancel(payload)
            case "jog" if payload == b'"a defect"':
                raise RuntimeError("a defect")
            case "degrade" if payload == b"":
                raise Refusal(Reason.NOT_JSON, what="degrade", error="nothing")
            case _:
                return None

    def arrive(self) -> Arrival:
        return Arrival(next(self._numbers), time.monotonic())

    def request(self, arrival: Arrival, key: str, message: Message, reply: Reply) -> None:
        self.heard.append((key, message))
        self.arrivals.append(arrival.number)
        answer = self._answer(key, message)
        if self.holding.is_set():
            self.waiting.append((reply, answer))
        else:
            reply(answer)

    def _answer(self, key: str, message: Message) -> Answer | LiveArm:
        match key, message:
            case "arm", _:
                return LiveArm([], [], False, None, None)
            case "goal", GoalMessage(id="far"):
                return refused(FAR, "far")
            case "goal", GoalMessage(id=known):
                return replace(done("accepted"), id=known or "made-up")
            case "degrade", _:
                return refused(NO_ACTUATOR)
            case _:
                return done(key)

    def keys(self) -> list[str]:
        return [key for key, _ in self.heard if key != "arm"]

    def description(self, wanted: Collection[str] = ()) -> Description:
        parts = {"drawing": Structure([], []), "file": None, "density": Density([1, 1, 1], [0.0] * 3, 1.0, 1.0, "")}
        return Description(name=ARM, **{key: parts[key] for key in wanted if key in parts})


class Gateway:
    """A server of one arm, and its clients' sessions; all are closed after the test."""

    def __init__(self, stack: ExitStack, endpoint: str) -> None:
        self._stack, self.endpoint = stack, endpoint
        self.planner, self.goals, self.published = FakePlanner(), RepeatedGoals(), list[Any]()
        self.rows: dict[str, dict[str, Any]] = {}
        self.readable = True
        self.session = stack.enter_context(zenoh.open(session.configuration("peer", listen=endpoint)))
        hooks = self.goals.ended, lambda *result: None, self.published.append
        self.outbox = Outbox(self.session, f"hyperbit/{ARM}", *hooks, lambda message: None)
        self.outbox.start()
        stack.callback(self.outbox.close)
        self.server = self.serve()
        stack.callback(lambda: self.server.close())

    def serve(self, clocks: Clocks = Clocks()) -> Server:
        poses = Poses(Path(self._stack.enter_context(TemporaryDirectory())) / "a.poses.json", "00")
        parts = GatewayParts(self.planner, self.outbox, self.goals, poses, self.find, clocks)  # type: ignore[arg-type]
        return Server(self.session, ARM, parts)

    def find(self, goal: str) -> dict[str, Any] | None:
        if not self.readable:
            raise sqlite3.OperationalError("unable to open database file")
        return self.rows.get(goal)

    def other(self) -> zenoh.Session:
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


def asked(session: zenoh.Session, key: str, payload: bytes = GOAL) -> list[dict[str, Any]]:
    replies = session.get(key, payload=payload, target=zenoh.QueryTarget.ALL, timeout=PATIENCE)
    return [json.loads(reply.ok.payload.to_bytes()) for reply in replies if reply.ok is not None]


@pytest.fixture
def endpoint() -> str:
    return free_endpoint()


@pytest.fixture
def gateway(endpoint: str) -> Iterator[Gateway]:
    with ExitStack() as stack:
        yield Gateway(stack, endpoint)
