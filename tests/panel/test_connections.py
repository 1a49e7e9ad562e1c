"""Idle connections of strangers, at several addresses and through a proxy, take no page, log-in or Stop away."""

import json
import resource
import socket
from collections.abc import Iterator
from contextlib import ExitStack
from http.client import HTTPConnection, HTTPResponse
from pathlib import Path

import pytest
from websockets.sync.client import ClientConnection, connect

from hyperbit.controller.panel.access.people import digest_of
from tests.endpoints import free_endpoint, free_port
from tests.forwarding import Forwarder
from tests.network.played import ARM, listening
from tests.panel.conftest import OPERATOR, running
from tests.waiting import PATIENCE, eventually

IDLE = 520


@pytest.fixture
def descriptors() -> Iterator[None]:
    """Enough for all ends of the connections."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (hard if hard != resource.RLIM_INFINITY else max(soft, 4096), hard))
    yield
    resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))


class Visit:
    """An operator at the page: requests over HTTP, each on a connection of its own, and an open page."""

    def __init__(self, url: str, closing: ExitStack) -> None:
        self.url, self.headers = url, {"origin": url}
        self.headers["cookie"] = str(self.log_in().headers["set-cookie"]).partition(";")[0]
        self.page: ClientConnection = closing.enter_context(
            connect(
                f"{url.replace('http', 'ws')}/arms/{ARM}/live",
                origin=url,  # type: ignore[arg-type]
                additional_headers={"cookie": self.headers["cookie"]},
                open_timeout=PATIENCE,
            )
        )

    def request(self, path: str, method: str = "POST", body: str = "") -> HTTPResponse:
        opened = HTTPConnection(self.url.rpartition("/")[2], timeout=PATIENCE)
        opened.request(method, path, body, self.headers)
        return opened.getresponse()

    def log_in(self) -> HTTPResponse:
        answer = self.request("/session", body=json.dumps({"token": OPERATOR}))
        assert answer.status == 200
        return answer

    def stops(self) -> bool:
        """Whether a stop over HTTP is accepted."""
        answer = self.request(f"/arms/{ARM}/stop")
        return answer.status == 200 and bool(json.loads(answer.read())["accepted"])

    def stops_from_the_page(self) -> bool:
        """Whether a stop over the page's WebSocket is accepted."""
        self.page.send(json.dumps({"do": "stop", "n": 7}))
        while True:
            for part in json.loads(self.page.recv(PATIENCE)):
                if part["section"] == "reply":
                    return bool(part["accepted"])


@pytest.mark.usefixtures("descriptors")
@pytest.mark.parametrize("through", ["addresses", "proxy"])
def test_idle_connections_take_nothing_from_an_operator(tmp_path: Path, through: str) -> None:
    endpoint, port = free_endpoint(), free_port()
    people = tmp_path / "people.yaml"
    people.write_text(f"people: [{{name: anna, role: operator, token: {digest_of(OPERATOR)}}}]\n")
    words = ["--listen", f"127.0.0.1:{port}", "--people", str(people), "--connect", endpoint]
    with ExitStack() as closing:
        listening(closing, endpoint)
        proxy = Forwarder(port)
        closing.callback(proxy.close)
        target = proxy.port if through == "proxy" else port
        closing.enter_context(running(tmp_path, *words, "--public", f"http://127.0.0.1:{target}"))
        visit = Visit(f"http://127.0.0.1:{target}", closing)
        eventually(visit.stops)
        before = proxy.opened
        idle = []
        for k in range(IDLE):
            own = (f"127.0.0.{k % 4 + 1}", 0) if through == "addresses" else None
            idle.append(closing.enter_context(socket.create_connection(("127.0.0.1", target), PATIENCE, own)))
        eventually(lambda: through == "addresses" or proxy.opened == before + IDLE)
        assert [idle[k].recv(1) for k in range(8)] == [b""] * 8, "the oldest are closed"
        assert visit.stops()
        assert visit.stops_from_the_page()
        assert Visit(visit.url, closing).stops()
    assert "Traceback" not in (tmp_path / "log").read_text()
