"""The routes of the page."""

import asyncio
import base64
import contextlib
import hashlib
import json
import re
from collections.abc import AsyncIterator, Callable
from pathlib import Path

import zenoh
from starlette.applications import Starlette
from starlette.exceptions import HTTPException
from starlette.requests import HTTPConnection, Request
from starlette.responses import FileResponse, JSONResponse, PlainTextResponse, Response
from starlette.routing import Mount, Route, WebSocketRoute
from starlette.staticfiles import StaticFiles
from starlette.types import ASGIApp
from starlette.websockets import WebSocket, WebSocketDisconnect

from controller.panel import requests
from controller.panel.access import LASTS, Access, Person, TooManyWrong
from controller.panel.arm_page import ArmPage, Flood, RequestThreads, encoded
from controller.panel.arm_view import ArmView
from controller.panel.arms import Arms, valid
from controller.panel.metrics import endpoint
from controller.panel.pages import Page
from controller.panel.shield import Shield, TooLarge, policy

STATIC = Path(__file__).parent / "static"
MOST_PAGES = 100
NO_LOGIN, TOO_MANY, BAD = 4401, 4429, 4400  # close codes of the WebSocket


class PanelServer:
    """The page's server.

    Attributes:
        app: the ASGI application.

    Args:
        open_session: opens the Zenoh session; called when the server starts.
        access: checks who may view and command.
        prefix: prefix of all Zenoh keys.
        secure: whether the page is served over TLS.
        local: whether the page is served on the loopback interface.
    """

    def __init__(
        self,
        open_session: Callable[[], zenoh.Session],
        access: Access,
        *,
        prefix: str = "hyperbit",
        secure: bool = False,
        local: bool = True,
    ) -> None:
        self._open_session, self._access, self._prefix, self._secure = open_session, access, prefix, secure
        self._cookie = "__Host-hyperbit" if secure else "hyperbit"
        self._pages = 0
        self._arms: Arms | None = None
        self._threads = RequestThreads()
        routes = [
            Route("/", self._shell, methods=["GET"]),
            Route("/arms/{name}", self._shell, methods=["GET"]),
            Route("/arms/{name}/density", self._density, methods=["GET"]),
            Route("/arms/{name}/stop", self._stop, methods=["POST"]),
            Route("/metrics", self._metrics, methods=["GET"]),
            Route("/session", self._enter, methods=["POST"]),
            Route("/session", self._leave, methods=["DELETE"]),
            WebSocketRoute("/live", self._live),
            WebSocketRoute("/arms/{name}/live", self._live),
            Mount("/static", StaticFiles(directory=STATIC)),
        ]
        handlers = {HTTPException: refuse, TooLarge: too_large}
        inner = Starlette(routes=routes, lifespan=self._lifespan, exception_handlers=handlers)
        self.app: ASGIApp = Shield(inner, policy(inline_scripts()), secure=secure, local=local)

    @contextlib.asynccontextmanager
    async def _lifespan(self, app: Starlette) -> AsyncIterator[None]:
        """Keeps the session open while the server runs."""
        session = await asyncio.to_thread(self._open_session)
        try:
            self._arms = Arms(session, self._prefix)
            yield
            await self._arms.close()
        finally:
            self._threads.close()
            await asyncio.to_thread(session.close)

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
        """Answers the page itself. It needs no login, because it contains no data."""
        if not valid(request.path_params.get("name", "a")):
            raise HTTPException(404, "There is no such arm.")
        return FileResponse(STATIC / "index.html")

    async def _density(self, request: Request) -> Response:
        """Answers the density of an arm's workspace."""
        if self._person(request) is None:
            raise HTTPException(401, "Log in first.")
        view = self.arms.views.get(request.path_params["name"])
        if view is None or view.background is None:
            raise HTTPException(404, "The density is not known.")
        kind, data = view.background
        return Response(data, media_type=kind)

    async def _metrics(self, request: Request) -> Response:
        """Answers the metrics of all arms in Prometheus' format, to people and to programs with a bearer token."""
        if self._person(request) is None:
            kind, _, token = request.headers.get("authorization", "").partition(" ")
            try:
                person = self._access.bearer(token) if kind.lower() == "bearer" else None
            except TooManyWrong:
                raise HTTPException(429, "Too many wrong tokens were sent: wait a minute.") from None
            if person is None:
                raise HTTPException(401, "Log in first, or send a bearer token.", {"www-authenticate": "Bearer"})
        return endpoint(self.arms.known, self.arms.counters)(request)

    async def _stop(self, request: Request) -> Response:
        """Stops an arm without the WebSocket, which may be closed at the moment."""
        person = self._person(request)
        if person is None or person.role != "operator":
            raise HTTPException(403, "Only operators may stop an arm.")
        view = self.arms.views.get(request.path_params["name"])
        if view is None:
            raise HTTPException(404, "There is no such arm.")
        loop = asyncio.get_running_loop()
        try:
            return JSONResponse(await loop.run_in_executor(self._threads.stops, view.client.request, "stop"))
        except RuntimeError as error:
            return JSONResponse({"accepted": False, "message": str(error)}, status_code=503)

    async def _enter(self, request: Request) -> Response:
        """Sets a cookie in exchange for a token."""
        try:
            token = json.loads(await request.body())["token"]
        except (ValueError, KeyError, TypeError, RecursionError):
            raise HTTPException(400, 'An object with "token" is needed.') from None
        try:
            cookie = self._access.enter(token) if isinstance(token, str) else None
        except TooManyWrong:
            raise HTTPException(429, "Too many wrong tokens were sent: wait a minute.") from None
        if cookie is None:
            raise HTTPException(403, "This token is nobody's.")
        person = self._access.person(cookie)
        response = JSONResponse({"name": person.name if person else "", "role": person.role if person else ""})
        response.set_cookie(
            self._cookie, cookie, max_age=int(LASTS), httponly=True, samesite="strict", secure=self._secure
        )
        return response

    async def _leave(self, request: Request) -> Response:
        """Deletes the cookie."""
        response = Response(status_code=204)
        response.delete_cookie(self._cookie, httponly=True, samesite="strict", secure=self._secure)
        return response

    # --- the WebSocket of a page

    async def _live(self, socket: WebSocket) -> None:
        """Sends a page the data of an arm, or the list of arms, and serves its requests until the page is closed."""
        person, name = self._person(socket), socket.path_params.get("name")
        await socket.accept()
        if person is None:
            await socket.close(NO_LOGIN, "log in first")
            return
        page = Page(person)
        view = self.arms.open(page, name) if self._pages < MOST_PAGES and (name is None or valid(name)) else None
        if self._pages >= MOST_PAGES or (name is not None and view is None):
            await socket.close(TOO_MANY, "too many pages are open, or there is no such arm")
            return
        self._pages += 1
        page.offer("you", encoded({"section": "you", "name": person.name, "role": person.role, "page": page.number}))
        sender = asyncio.create_task(page.send_updates(lambda data: socket.send_text(data.decode())))
        receiver = asyncio.create_task(self._receive(socket, view, page))
        try:
            await asyncio.wait([sender, receiver], return_when=asyncio.FIRST_COMPLETED)
        finally:
            self._pages -= 1
            self.arms.shut(page, view)
            for task in (sender, receiver):
                task.cancel()  # has no effect on a task that has ended
        ended = receiver.done() and not receiver.cancelled() and receiver.exception() is None
        code = receiver.result() if ended else TOO_MANY
        with contextlib.suppress(RuntimeError, WebSocketDisconnect):  # already closed
            await socket.close(code)

    async def _receive(self, socket: WebSocket, view: ArmView | None, page: Page) -> int:
        """Serves the requests of a page; returns the close code of its WebSocket."""
        arm_page = None if view is None else ArmPage(view, page, self._threads)
        while True:
            message = await socket.receive()
            if message["type"] == "websocket.disconnect":
                return 1000
            text = message.get("text")
            if arm_page is None or text is None:
                return BAD
            try:
                arm_page.receive_request(requests.decode_request(text))
            except requests.BadRequest as error:
                arm_page.refuse(0, str(error))
            except Flood:
                return TOO_MANY


def inline_scripts() -> str:
    """Returns the hashes of the page's inline scripts (the import map) for the content security policy."""
    text = (STATIC / "index.html").read_text(encoding="utf-8")
    parts = re.findall(r"<script type=\"importmap\">(.*?)</script>", text, re.DOTALL)
    return " ".join(f"'sha256-{base64.b64encode(hashlib.sha256(part.encode()).digest()).decode()}'" for part in parts)


async def refuse(request: Request, error: Exception) -> Response:
    """Answers a refusal with a sentence."""
    status = error.status_code if isinstance(error, HTTPException) else 500
    known = {404: "There is no such address.", 405: "This address does not support this method."}
    detail = error.detail if isinstance(error, HTTPException) else ""
    sentence = known.get(status, detail) if detail in ("Not Found", "Method Not Allowed") else detail
    headers = error.headers if isinstance(error, HTTPException) else None
    return PlainTextResponse(f"{sentence}\n", status_code=status, headers=headers)


async def too_large(request: Request, error: Exception) -> Response:
    """Answers that a body is too large or too slow."""
    return PlainTextResponse("The body is too large, or arrives too slowly.\n", status_code=413)
