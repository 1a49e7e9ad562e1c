"""A panel on a real Zenoh session, with a played arm, and its logged-in clients."""

import contextlib
import json
import re
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest
import zenoh
from starlette.testclient import TestClient, WebSocketTestSession
from starlette.websockets import WebSocketDisconnect

from hyperbit.controller.network.reach import NoSession
from hyperbit.controller.panel.access.access import Access
from hyperbit.controller.panel.access.people import PersonEntry, digest_of
from hyperbit.controller.panel.app import PanelServer
from hyperbit.controller.panel.serve import zenoh_configuration
from tests.clock import Clock
from tests.commands.conftest import hyperbit  # noqa: F401
from tests.endpoints import free_endpoint
from tests.network.played import ARM, listening
from tests.system.stack.processes import Process, commands
from tests.waiting import eventually

Message = dict[str, Any]

ORIGIN, SOCKETS = "http://127.0.0.1:7480", "ws://127.0.0.1:7480"
OPERATOR, OTHER, VIEWER = "operator's token", "another operator's token", "viewer's token"
GUARD = "token of a viewer who may stop"
PEOPLE = (
    PersonEntry("anna", "operator", digest_of(OPERATOR)),
    PersonEntry("bert", "operator", digest_of(OTHER)),
    PersonEntry("hall", "viewer", digest_of(VIEWER)),
    PersonEntry("dora", "viewer", digest_of(GUARD), stop=True),
    PersonEntry("carl", "operator"),  # by certificate only
)


GOAL = {"waypoints": [{"position": [0.5, 2.9]}]}
COMMANDS = [
    ("stop", {}),
    ("cancel", {}),
    ("reset", {}),
    ("take", {}),
    ("jog", {"actuator": "5.left", "state": "extended"}),
    ("lock", {"actuator": "5.left", "state": 0}),
    ("obstacles", {"regions": []}),
    ("pose", {"remove": "pick"}),
    ("plan", {"goal": GOAL}),
    ("go", {"goal": GOAL}),
    ("file", {"text": "waypoints: []"}),
    ("again", {"id": "g"}),
    ("answer", {"question": 1, "answer": ""}),
]


@contextlib.contextmanager
def running(folder: Path, *words: str) -> Iterator[tuple[Process, list[str]]]:
    """Runs the panel without a daemon; returns after it has printed its addresses."""
    log = folder / "log"
    process = commands().start(["panel", "--connect", free_endpoint(), *words], log, {"NOTIFY_SOCKET": ""})
    try:
        eventually(lambda: not process.alive or "hyperbit panel, " in log.read_text())
        yield process, re.findall(r"https?://\S+", log.read_text())
    finally:
        process.end()


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
        self.daemon = listening(closing, endpoint, prefix)
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
