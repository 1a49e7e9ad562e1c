"""A panel on a real Zenoh session, and a fake daemon that records requests and answers at once."""

import functools
import json
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from typing import Any

import pytest
import zenoh
from starlette.testclient import TestClient, WebSocketTestSession
from starlette.websockets import WebSocketDisconnect

from hyperbit.controller.arm.arm import Arm, load
from hyperbit.controller.arm.description import description, drawing
from hyperbit.controller.manipulator.notation import format_configuration, pose
from hyperbit.controller.network import session
from hyperbit.controller.network.reach import NoSession
from hyperbit.controller.panel.access.access import Access
from hyperbit.controller.panel.access.people import PersonEntry, digest_of
from hyperbit.controller.panel.app import PanelServer
from hyperbit.controller.panel.serve import zenoh_configuration
from tests.clock import Clock
from tests.commands.conftest import hyperbit  # noqa: F401
from tests.endpoints import free_endpoint
from tests.keys import DEPLOY
from tests.waiting import eventually

Message = dict[str, Any]

ARM = "planar16"
ORIGIN, SOCKETS = "http://127.0.0.1:7480", "ws://127.0.0.1:7480"
OPERATOR, OTHER, VIEWER = "operator's token", "another operator's token", "viewer's token"
PEOPLE = (
    PersonEntry("anna", "operator", digest_of(OPERATOR)),
    PersonEntry("bert", "operator", digest_of(OTHER)),
    PersonEntry("hall", "viewer", digest_of(VIEWER)),
    PersonEntry("carl", "operator"),  # by certificate only
)
PATIENCE = 60.0  # [s]


@functools.cache
def paper_arm() -> Arm:
    return load(DEPLOY / f"{ARM}.yaml")


class PlayedDaemon:
    """A fake daemon of one arm; it listens at an endpoint, or is a client of a router there.

    Attributes:
        asked: key and payload of each request except `arm`.
        gate: event that answers to `plan` wait for.
    """

    def __init__(self, endpoint: str, name: str = ARM, *, mode: str = "peer", prefix: str = "hyperbit") -> None:
        arm = paper_arm()
        self.manipulator, self._keys_of = arm.manipulator, f"{prefix}/{name}"
        self.told = {
            **description(arm),
            "name": name,
            "drawing": drawing(arm),
            "limits": [],
            "sent_obstacles": [],
            "running": None,
        }
        self.asked: list[tuple[str, Message]] = []
        self.gate = threading.Event()
        self.gate.set()
        self.planned: Message = {}
        self.homing: list[str] = []
        self.answer: Message = {"accepted": True, "code": 0, "message": "done"}
        self._latest: Message | None = None
        self._order = threading.Lock()
        self.session = zenoh.open(
            session.configuration(mode, **{"connect" if mode == "client" else "listen": endpoint})
        )
        self._keys: list[Any] = [
            self.session.declare_queryable(f"{self._keys_of}/{key}", self._answer)
            for key in ("arm", "plan", "goal", "jog", "stop", "cancel", "reset", "degrade", "obstacles", "fault")
        ]
        self._token: Any = self.session.liveliness().declare_token(f"{self._keys_of}/alive")

    def _answer(self, query: zenoh.Query) -> None:
        key = str(query.key_expr).rpartition("/")[2]
        payload = json.loads(query.payload.to_bytes()) if query.payload else {}
        if key == "arm":
            wanted = payload.get("with", [])
            answer = {k: v for k, v in self.told.items() if k in wanted or k not in ("drawing", "running")}
        else:
            self.asked.append((key, payload))
            answer = self.answer
        if key == "plan":
            self.gate.wait(PATIENCE)
            point = {"configuration": "1" * 16, "between": False, **self.planned}
            answer = {**answer, "waypoints": [point], "switches": 3, "homing": self.homing}
        if key == "goal":
            answer = {**answer, "id": payload["id"]}
        query.reply(f"{self._keys_of}/{key}", json.dumps(answer).encode())

    def commands(self) -> list[str]:
        return [key for key, _ in self.asked]

    def state(self, **fields: Any) -> Message:
        states = [0] * len(self.manipulator.actuators)
        home = [0] * 16
        told = {
            **{"stamp": 0.0, "mode": "ready", "reason": "holding", "commanded": states, "measured": states},
            **{"configuration": format_configuration(self.manipulator, home), "goal": None, "waypoint": None},
            **{"target": None, "obstacles": 0, "faults": [], "degraded": []},
            "tip": pose(self.manipulator, self.manipulator.tip(home)),
            **fields,
        }
        with self._order:
            self._latest = told
            self.put("state", told)
        return told

    def repeat(self) -> None:
        """Publishes the latest state again, as a daemon does whose arm stands."""
        with self._order:
            if self._latest is not None:
                self.put("state", self._latest)

    def put(self, key: str, payload: Message) -> None:
        self.session.put(f"{self._keys_of}/{key}", json.dumps(payload).encode())

    def die(self) -> None:
        """Removes the liveliness token."""
        self._token.undeclare()

    def close(self) -> None:
        self.gate.set()
        self.session.close()  # type: ignore[no-untyped-call]


class Opened:
    def __init__(self, socket: WebSocketTestSession) -> None:
        self.socket = socket
        self.latest: dict[str, Message] = {}
        self._number = 0

    def heard(self) -> list[Message]:
        """Returns the parts of the next message."""
        parts: list[Message] = json.loads(self.socket.receive_text())
        for part in parts:
            self.latest[part["section"]] = part
        return parts

    def until(self, section: str, condition: Callable[[Message], Any] = lambda message: True) -> Message:
        """Waits for a section that meets a condition; the section may have arrived already."""
        if section in self.latest and condition(self.latest[section]):
            return self.latest[section]
        while True:
            for part in self.heard():
                if part["section"] == section and condition(part):
                    return part

    def closed(self) -> int:
        """Reads until the page is closed; returns the close code."""
        try:
            while True:
                self.heard()
        except WebSocketDisconnect as closed:
            return closed.code

    def send(self, do: str, **fields: Any) -> int:
        """Sends a request with the latest heartbeat that was heard; returns its number."""
        self._number += 1
        heartbeat = self.until("heartbeat")["number"]
        self.socket.send_text(json.dumps({"do": do, "n": self._number, "heartbeat": heartbeat, **fields}))
        return self._number

    def ask(self, do: str, **fields: Any) -> Message:
        number = self.send(do, **fields)
        return self.until("reply", lambda reply: reply["n"] == number)


class Site:
    """A running panel, its daemon, and logged-in clients.

    Attributes:
        missing: what the panel learns of endpoints without connection.
    """

    def __init__(self, closing: ExitStack, prefix: str = "hyperbit") -> None:
        self.endpoint = endpoint = free_endpoint()
        self.daemon = PlayedDaemon(endpoint, prefix=prefix)
        closing.callback(self.daemon.close)
        config = zenoh_configuration([endpoint], None)
        self.clock = Clock()  # it stands: no command becomes too late while this machine is slow
        self.missing: list[NoSession] = []
        self.panel = PanelServer(
            lambda: zenoh.open(config), Access(PEOPLE), lambda _: self.missing, prefix=prefix, clock=self.clock
        )
        self.browser = closing.enter_context(TestClient(self.panel.app, base_url=ORIGIN))
        self._closing = closing
        eventually(lambda: ARM in self.panel.arms.views and self.panel.arms.views[ARM].drawing)

    def cookie(self, token: str) -> dict[str, str]:
        """Logs in; returns the headers of the person's requests."""
        self.browser.cookies.clear()
        answer = self.browser.post("/session", json={"token": token}, headers={"origin": ORIGIN})
        assert answer.status_code == 200, answer.text
        cookie = answer.headers["set-cookie"].partition(";")[0]
        self.browser.cookies.clear()
        return {"cookie": cookie, "origin": ORIGIN}

    def open(self, token: str = OPERATOR, path: str = f"/arms/{ARM}/live") -> Opened:
        socket = self.browser.websocket_connect(SOCKETS + path, headers=self.cookie(token))
        return Opened(self.enter(socket))

    def enter(self, socket: WebSocketTestSession) -> WebSocketTestSession:
        """Opens a WebSocket until the site ends."""
        return self._closing.enter_context(socket)


@pytest.fixture
def site() -> Iterator[Site]:
    with ExitStack() as closing:
        yield Site(closing)


@pytest.fixture
def past() -> Iterator[Site]:
    """The panel of a replay."""
    with ExitStack() as closing:
        yield Site(closing, "replay")
