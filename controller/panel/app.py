import asyncio
import base64
import contextlib
import hashlib
import html
import logging
import re
import time
from collections.abc import AsyncIterator, Callable, Sequence
from pathlib import Path
from typing import Any

import zenoh
from starlette.applications import Starlette
from starlette.exceptions import HTTPException
from starlette.requests import HTTPConnection, Request
from starlette.responses import HTMLResponse, JSONResponse, PlainTextResponse, Response
from starlette.routing import Mount, Route, WebSocketRoute
from starlette.staticfiles import StaticFiles
from starlette.types import ASGIApp, Receive, Scope, Send
from starlette.websockets import WebSocket, WebSocketDisconnect

from hyperbit.controller.decoding.decoding import Unreadable, decode
from hyperbit.controller.network.fleet import is_name
from hyperbit.controller.network.reach import NoSession
from hyperbit.controller.network.stop_all import stop_all
from hyperbit.controller.panel import requests
from hyperbit.controller.panel.access.access import Access
from hyperbit.controller.panel.access.doors import Doors
from hyperbit.controller.panel.access.people import Person
from hyperbit.controller.panel.access.places import PagePlace, Places
from hyperbit.controller.panel.access.sessions import LASTS
from hyperbit.controller.panel.access.wrong_tokens import WrongTokens
from hyperbit.controller.panel.arm_page import ArmPage, Flood, RequestThreads, encoded
from hyperbit.controller.panel.arms.arm_view import ArmView
from hyperbit.controller.panel.arms.arms import Arms
from hyperbit.controller.panel.arms.metrics import endpoint
from hyperbit.controller.panel.arms.pages import Page
from hyperbit.controller.panel.shield import LOCAL, PublicAddress, Shield, TooLarge, policy

log = logging.getLogger(__name__)

DAEMONS = "hyperbit"  # prefix of their keys
STATIC = Path(__file__).parent / "static"
SESSION_EVERY = 1.0  # [s] between two checks of an open page's session
CLOSED = (WebSocketDisconnect, RuntimeError)  # raised by a WebSocket that has ended
NO_LOGIN, TOO_MANY, BAD = 4401, 4429, 4400  # close codes of the WebSocket


class PanelServer:
    """The page's server.

    Args:
        open_session: opens the Zenoh session; called when the server starts.
        missing: returns why the session has no connection to some of its endpoints.
        access: checks who may view and command.
        prefix: of all Zenoh keys; another prefix than the daemons' is that of a replay.
        tls: whether the page itself is served over TLS.
        hosts: accepted host names; None: any.
        public: address at a reverse proxy; None: there is no proxy.
        clock: returns the time of the pages' heartbeats [s].
    """

    def __init__(
        self,
        open_session: Callable[[], zenoh.Session],
        access: Access,
        missing: Callable[[zenoh.Session], list[NoSession]] = lambda _: [],
        *,
        prefix: str = DAEMONS,
        tls: bool = False,
        hosts: Sequence[str] | None = LOCAL,
        public: PublicAddress | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._missing = missing
        self._open_session, self._access, self._prefix, self._clock = open_session, access, prefix, clock
        self._replay = prefix != DAEMONS
        self._path = "/" if public is None else public.path
        secure = tls or (public is not None and public.origin.startswith("https:"))
        self._cookie = "hyperbit" if not secure else "__Host-hyperbit" if self._path == "/" else "__Secure-hyperbit"
        self._cookie_kind: dict[str, Any] = {
            "path": self._path,
            "httponly": True,
            "samesite": "strict",
            "secure": secure,
        }
        text = (STATIC / "index.html").read_text(encoding="utf-8")
        self._page = text.replace('<base href="/" />', f'<base href="{html.escape(self._path)}" />')
        self.doors, self._places, self._wrong = Doors(), Places(), WrongTokens()
        self._arms: Arms | None = None
        self._threads = RequestThreads()
        routes = [
            Route("/", self._shell, methods=["GET"]),
            Route("/arms/{name}", self._shell, methods=["GET"]),
            Route("/arms/{name}/density", self._density, methods=["GET"]),
            Route("/arms/{name}/stop", self._stop, methods=["POST"]),
            Route("/stop", self._stop_all, methods=["POST"]),
            Route("/metrics", self._metrics, methods=["GET"]),
            Route("/session", self._enter, methods=["POST"]),
            Route("/session", self._leave, methods=["DELETE"]),
            WebSocketRoute("/live", self._live),
            WebSocketRoute("/arms/{name}/live", self._live),
            Mount("/static", StaticFiles(directory=STATIC)),
        ]
        handlers = {HTTPException: refuse, TooLarge: too_large}
        self._routed = Starlette(routes=routes, lifespan=self._lifespan, exception_handlers=handlers)
        self._routed.router.redirect_slashes = False  # Starlette decodes the query for it, and fails if it is no UTF-8
        scheme = "https" if tls else "http"
        self.app: ASGIApp = Shield(
            self._recognized, policy(inline_scripts(text)), scheme=scheme, hosts=hosts, public=public
        )

    @contextlib.asynccontextmanager
    async def _lifespan(self, app: Starlette) -> AsyncIterator[None]:
        session = await asyncio.to_thread(self._open_session)
        try:
            self._arms = Arms(session, self._prefix, lambda: self._missing(session), replay=self._replay)
            yield
            await self._arms.close()
        finally:
            self._threads.close()
            await asyncio.to_thread(session.close)

    async def _recognized(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serves a request; its connection has the place of its person from now on."""
        if scope["type"] in ("http", "websocket"):
            person = self._person(HTTPConnection(scope))
            self.doors.recognize(scope["client"], None if person is None else person.role)
        await self._routed(scope, receive, send)

    @property
    def arms(self) -> Arms:
        """The arms. Valid only while the server runs."""
        assert self._arms is not None
        return self._arms

    def _person(self, connection: HTTPConnection) -> Person | None:
        """Returns the person of a connection, by client certificate or by cookie; None if unknown."""
        certified = self._access.certified(connection.scope.get("state", {}).get("certificate"))
        return certified or self._access.person(connection.cookies.get(self._cookie))

    # --- requests over HTTP

    async def _shell(self, request: Request) -> Response:
        """Answers with the page itself. It needs no login, because it contains no data."""
        if not is_name(request.path_params.get("name", "a")):
            raise HTTPException(404, "There is no such arm.")
        return HTMLResponse(self._page)

    async def _density(self, request: Request) -> Response:
        if self._person(request) is None:
            raise HTTPException(401, "Log in first.")
        view = self.arms.views.get(request.path_params["name"])
        if view is None or view.background is None:
            raise HTTPException(404, "The density is not known.")
        kind, data = view.background
        return Response(data, media_type=kind)

    async def _metrics(self, request: Request) -> Response:
        """Answers with the metrics of all arms in Prometheus' format, to people and to programs with a bearer token."""
        if self._person(request) is None:
            kind, _, token = request.headers.get("authorization", "").partition(" ")
            if kind.lower() != "bearer":
                raise HTTPException(401, "Log in first, or send a bearer token.", {"www-authenticate": "Bearer"})
            if self._access.bearer(token) is None:
                await self._delay(request)
                raise HTTPException(401, "Log in first, or send a bearer token.", {"www-authenticate": "Bearer"})
        return endpoint(self.arms.known, self.arms.counters)(request)

    async def _stop(self, request: Request) -> Response:
        """Stops an arm without the WebSocket, which may be closed at the moment, also an arm that was not heard yet."""
        self._check_may_stop(request)
        if not is_name(name := request.path_params["name"]):
            raise HTTPException(404, "There is no such arm.")
        loop, client = asyncio.get_running_loop(), self.arms.client(name)
        try:
            return JSONResponse(await loop.run_in_executor(self._threads.stops, client.request, "stop"))
        except RuntimeError as error:
            return JSONResponse({"accepted": False, "message": str(error)}, status_code=503)

    async def _stop_all(self, request: Request) -> Response:
        """Stops all arms below the page's prefix, and answers which have stopped."""
        self._check_may_stop(request)
        loop, places = asyncio.get_running_loop(), (f"{self._prefix}/*",)
        report = await loop.run_in_executor(self._threads.stops, stop_all, self.arms.session, places)
        failed = [f"{arm}: no answer" for arm in report.silent]
        failed += [f"{arm}: {answer.message}" for arm, answer in report.answers.items() if not answer.accepted]
        stopped = ", ".join(str(arm) for arm, answer in report.answers.items() if answer.accepted)
        parts = [*failed, f"stopped: {stopped}" if stopped else "no arm has stopped"]
        return JSONResponse({"accepted": report.complete, "message": "; ".join(parts)})

    def _check_may_stop(self, request: Request) -> None:
        """Raises HTTPException unless the person of a request may stop."""
        person = self._person(request)
        if person is None or not person.may_stop:
            raise HTTPException(
                403, "Only operators may stop an arm, and viewers whose entry of the file of people says so."
            )

    async def _enter(self, request: Request) -> Response:
        """Begins a session in exchange for a token, and sets its cookie."""
        try:
            token = decode(await request.body(), dict[str, str])["token"]
        except (Unreadable, KeyError):
            raise HTTPException(400, 'An object with "token", a text, is needed.') from None
        cookie = self._access.enter(token)
        if cookie is None:
            await self._delay(request)
            raise HTTPException(403, "This token is nobody's.")
        person = self._access.person(cookie)
        response = JSONResponse({"name": person.name if person else "", "role": person.role if person else ""})
        response.set_cookie(self._cookie, cookie, max_age=int(LASTS), **self._cookie_kind)
        return response

    async def _leave(self, request: Request) -> Response:
        self._access.leave(request.cookies.get(self._cookie))
        response = Response(status_code=204)
        response.delete_cookie(self._cookie, **self._cookie_kind)
        return response

    async def _delay(self, request: Request) -> None:
        await asyncio.sleep(self._wrong.delay(address_of(request)))

    # --- the WebSocket of a page

    async def _live(self, socket: WebSocket) -> None:
        """Sends the data of an arm, or the list of arms, to a page, and serves its requests until it closes."""
        person, name = self._person(socket), socket.path_params.get("name")
        await socket.accept()
        if person is None:
            await socket.close(NO_LOGIN, "log in first")
            return
        page, place = Page(person, self._clock), PagePlace(person, address_of(socket))
        if (refusal := self._places.refusal(place)) is not None:
            await socket.close(TOO_MANY, refusal)
            return
        view = self.arms.open(page, name) if name is None or is_name(name) else None
        if name is not None and view is None:
            await socket.close(TOO_MANY, "too many arms are known, or there is no such arm")
            return
        self._places.take_place(place)
        self.doors.leave(socket.scope["client"])
        you = {"name": person.name, "role": person.role, "stop": person.may_stop}
        page.offer("you", encoded({"section": "you", **you, "page": page.number, "replay": self._replay}))
        sender = asyncio.create_task(page.send_updates(lambda data: socket.send_text(data.decode())))
        receiver = asyncio.create_task(self._receive(socket, view, page))
        for task in (sender, receiver):
            task.add_done_callback(tell_defect)
        try:
            done = set[asyncio.Task[Any]]()
            while not done and self._person(socket) is not None:
                done, _ = await asyncio.wait(
                    [sender, receiver], timeout=SESSION_EVERY, return_when=asyncio.FIRST_COMPLETED
                )
        finally:
            self._places.free_place(place)
            self.arms.shut(page, view)
            for task in (sender, receiver):
                task.cancel()  # has no effect on a task that has ended
        code = TOO_MANY if done else NO_LOGIN
        if receiver in done and receiver.exception() is None:
            code = receiver.result()
        with contextlib.suppress(*CLOSED):
            await socket.close(code)

    async def _receive(self, socket: WebSocket, view: ArmView | None, page: Page) -> int:
        """Serves the requests of a page; returns the close code of its WebSocket."""
        arm_page = None if view is None else ArmPage(view, page, self._threads)
        while True:
            message = await socket.receive()
            if message["type"] == "websocket.disconnect":
                return 1000
            text = message.get("text")
            if self._person(socket) is None:
                return NO_LOGIN
            if arm_page is None or text is None:
                return BAD
            try:
                arm_page.receive_request(requests.decode_request(text))
            except requests.BadRequest as error:
                arm_page.refuse(0, str(error))
            except Flood:
                return TOO_MANY


def tell_defect(task: asyncio.Task[Any]) -> None:
    """Logs the exception of a page's task, unless the page has closed."""
    error = None if task.cancelled() else task.exception()
    if error is not None and not isinstance(error, CLOSED):
        log.error("an open page failed", exc_info=error)


def address_of(connection: HTTPConnection) -> str:
    return connection.client.host if connection.client else ""


def inline_scripts(text: str) -> str:
    """Returns the hashes of a page's inline scripts (the import map) for the content security policy."""
    parts = re.findall(r"<script type=\"importmap\">(.*?)</script>", text, re.DOTALL)
    return " ".join(f"'sha256-{base64.b64encode(hashlib.sha256(part.encode()).digest()).decode()}'" for part in parts)


async def refuse(request: Request, error: Exception) -> Response:
    status = error.status_code if isinstance(error, HTTPException) else 500
    known = {404: "There is no such address.", 405: "This address does not support this method."}
    detail = error.detail if isinstance(error, HTTPException) else ""
    sentence = known.get(status, detail) if detail in ("Not Found", "Method Not Allowed") else detail
    headers = error.headers if isinstance(error, HTTPException) else None
    return PlainTextResponse(f"{sentence}\n", status_code=status, headers=headers)


async def too_large(request: Request, error: Exception) -> Response:
    return PlainTextResponse("The body is too large, or arrives too slowly.\n", status_code=413)
