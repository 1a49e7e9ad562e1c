"""Refuses foreign hosts, foreign origins and large bodies, and sets security headers."""

import asyncio
from collections.abc import Sequence
from typing import NamedTuple

from starlette.datastructures import Headers, MutableHeaders
from starlette.responses import PlainTextResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send

MOST_BODY = 4096  # bytes
MOST_PATH = 512
BODY_WITHIN = 10.0  # [s] for the body of a request
LOCAL = ("127.0.0.1", "localhost", "[::1]")


class PublicAddress(NamedTuple):
    """Address of the page in a browser, if a reverse proxy stands before it.

    Attributes:
        origin: scheme, host and port, such as "https://robot.local".
        path: begins and ends with "/".
    """

    origin: str
    path: str


def policy(scripts: str) -> str:
    """Returns the content security policy; `scripts` are the hashes of the page's own inline scripts."""
    return (
        f"default-src 'none'; script-src 'self' {scripts}; style-src 'self'; img-src 'self' data:; connect-src 'self';"
        " font-src 'self'; base-uri 'self'; form-action 'none'; frame-ancestors 'none'"
    )


class Shield:
    """Checks each request and sets the headers of each answer.

    `csp` is the content security policy; `scheme` is "https" if the page itself has TLS. `hosts` are accepted host
    names, which prevents DNS rebinding; None: any. `public` is the address at a reverse proxy; None: there is none.
    """

    def __init__(
        self, app: ASGIApp, csp: str, *, scheme: str, hosts: Sequence[str] | None, public: PublicAddress | None
    ) -> None:
        self._app, self._scheme, self._hosts, self._public = app, scheme, hosts, public
        if hosts is not None and public is not None:
            self._hosts = (*hosts, public.origin.partition("://")[2])
        self._headers = {
            "content-security-policy": csp,
            "x-content-type-options": "nosniff",
            "x-frame-options": "DENY",
            "referrer-policy": "no-referrer",
            "cross-origin-opener-policy": "same-origin",
            "cross-origin-resource-policy": "same-origin",
            "permissions-policy": "camera=(), microphone=(), geolocation=()",
            "cache-control": "no-cache",
        }

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            return

        async def answer(message: Message) -> None:
            if message["type"] in ("http.response.start", "websocket.http.response.start"):
                headers = MutableHeaders(scope=message)
                for name, value in self._headers.items():
                    headers.setdefault(name, value)
            await send(message)

        if (refusal := self._refusal(scope)) is not None:
            response = PlainTextResponse(f"{refusal[1]}\n", status_code=refusal[0])
            await response(scope, receive, answer)
            return
        if scope["type"] == "http" and scope["method"] not in ("GET", "HEAD"):
            receive = limited(receive)
        if self._public is not None and scope["path"].startswith(self._public.path):  # the proxy may keep the path
            scope = {**scope, "path": scope["path"][len(self._public.path) - 1 :]}
        await self._app(scope, receive, answer)

    def _refusal(self, scope: Scope) -> tuple[int, str] | None:
        headers = Headers(scope=scope)
        hosts = headers.getlist("host")
        if len(hosts) != 1:
            return 400, "One header Host is needed."
        if self._hosts is not None and not {hosts[0], hosts[0].rpartition(":")[0]} & set(self._hosts):
            names = " or ".join(dict.fromkeys(self._hosts))
            return 400, f"This page has another address: use {names}. Behind a proxy give hyperbit panel --public URL."
        if len(scope["path"]) > MOST_PATH:
            return 414, "The path is too long."
        changes = scope["type"] == "websocket" or scope["method"] not in ("GET", "HEAD")
        origins = headers.getlist("origin")
        public = "" if self._public is None else self._public.origin
        own = public if hosts[0] == public.partition("://")[2] else f"{self._scheme}://{hosts[0]}"
        if changes and (len(origins) != 1 or origins[0] not in {own, public} - {""}):
            return 403, "This request does not come from this page. Behind a proxy give hyperbit panel --public URL."
        size = headers.get("content-length", "0")
        if not (size.isascii() and size.isdecimal() and len(size) < 10 and int(size) <= MOST_BODY):
            return 413, f"At most {MOST_BODY} bytes are accepted."
        return None


class TooLarge(Exception):
    """A body is too large, or arrives too slowly."""


def limited(receive: Receive) -> Receive:
    """Returns a function that receives a body of bounded size in bounded time, or raises TooLarge."""
    size = 0

    async def bounded() -> Message:
        nonlocal size
        try:
            async with asyncio.timeout(BODY_WITHIN):
                message = await receive()
        except TimeoutError:
            raise TooLarge from None
        size += len(message.get("body", b""))
        if size > MOST_BODY:
            raise TooLarge
        return message

    return bounded
