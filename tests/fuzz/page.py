"""The readers of the page: messages of an arm, requests of browsers, and HTTP."""

from __future__ import annotations

import asyncio
import contextlib
import json
from typing import Any
from unittest import mock

import msgspec
import zenoh

from hyperbit.controller.network import client
from hyperbit.controller.panel.access.access import Access
from hyperbit.controller.panel.access.people import Person
from hyperbit.controller.panel.app import PanelServer
from hyperbit.controller.panel.arms import arm_view
from hyperbit.controller.panel.arms.arms import Arms
from hyperbit.controller.panel.arms.metrics import exposition
from hyperbit.controller.panel.arms.pages import Page
from hyperbit.controller.panel.requests import BadRequest, decode_request
from tests.fuzz.still import Sample, StillSession, Take
from tests.panel.conftest import PEOPLE


def page() -> Take:
    """The page's view of an arm, with an open page, and the metrics."""
    session, loop = StillSession(), asyncio.new_event_loop()

    async def opened() -> tuple[Arms, Page]:
        arms = Arms(session, "hyperbit", lambda: [], replay=True)  # type: ignore[arg-type]
        one = Page(Person("anna", "operator"))
        arms.open(one, "planar16")
        return arms, one

    arms, one = loop.run_until_complete(opened())
    for task in arms._tasks:
        task.cancel()

    async def turn(key: str, data: bytes) -> None:
        view = arms.views["planar16"]
        if key == "arm":
            session.answer, view._again = data, True
            view._wanted = {"drawing", "running", "density"}
            with mock.patch.object(arm_view, "ASK_AGAIN", 0.0), mock.patch.object(client, "PAUSE", 0.0):
                await view._answer()
        else:
            session.subscribers[f"hyperbit/*/{key}"](Sample(f"hyperbit/planar16/{key}", zenoh.ZBytes(data)))
            for _ in range(3):
                await asyncio.sleep(0)
            arms.hear_states(due=True)
            view.cancel_request()  # of a description, which this state asks for
        for section in one._latest.values():
            json.loads(section)
        exposition(arms.known(), arms.counters)

    return lambda key, data: loop.run_until_complete(turn(key, data))


def page_request() -> Take:
    def take(key: str, data: bytes) -> None:
        with contextlib.suppress(BadRequest):
            msgspec.json.encode(decode_request(data.decode("utf-8", "surrogateescape")))

    return take


def http() -> Take:
    """The log-in, headers and paths of the page's server."""
    server, loop = PanelServer(StillSession, Access(PEOPLE)), asyncio.new_event_loop()  # type: ignore[arg-type]
    server._wrong.delay = lambda address: 0.0  # type: ignore[method-assign]

    async def ask_server(key: str, data: bytes) -> list[Any]:
        sent: list[Any] = []
        path = (
            data.decode("utf-8", "replace") if key == "path" else "/metrics" if key == "authorization" else "/session"
        )
        headers = [(b"host", b"127.0.0.1:7480"), (b"origin", b"http://127.0.0.1:7480")]
        headers += [(key.encode(), data)] if key in ("cookie", "authorization", "origin", "host") else []
        method = "GET" if key in ("path", "authorization") else "DELETE" if key == "cookie" else "POST"
        scope = {
            **{"type": "http", "http_version": "1.1", "method": method, "scheme": "http", "path": path, "state": {}},
            **{"raw_path": data, "query_string": data if key == "path" else b"", "headers": headers},
            **{"client": ("127.0.0.1", 1), "server": ("127.0.0.1", 7480), "root_path": ""},
        }
        body = {"type": "http.request", "body": data if key == "session" else b"{}", "more_body": False}

        async def receive() -> Any:
            return body

        async def send(message: Any) -> None:
            sent.append(message)

        await server.app(scope, receive, send)
        return sent

    def take(key: str, data: bytes) -> None:
        answer = loop.run_until_complete(ask_server(key, data))
        assert answer[0]["status"] < 500, answer

    return take
