"""The page's web server: address, TLS, people, and uvicorn."""

import asyncio
import errno
import ipaddress
import json
import re
import socket
import ssl
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import uvicorn
import zenoh

from hyperbit.controller.armfile.strict import InputFaults
from hyperbit.controller.host.notify import Notifier
from hyperbit.controller.host.output import flush_outputs
from hyperbit.controller.host.signals import end_on_signals
from hyperbit.controller.network import session
from hyperbit.controller.network.endpoints import parse_endpoint
from hyperbit.controller.network.reach import missing_peers, open_session
from hyperbit.controller.panel.access.access import Access
from hyperbit.controller.panel.access.doors import CountedSocket
from hyperbit.controller.panel.access.people import PersonEntry, digest_of, new_token, read_people
from hyperbit.controller.panel.access.sessions import sessions_file
from hyperbit.controller.panel.app import PanelServer
from hyperbit.controller.panel.http import CertifiedWebSocket, GuardedHttp
from hyperbit.controller.panel.requests import MOST_BYTES
from hyperbit.controller.panel.shield import LOCAL, PublicAddress

BACKLOG = 1024  # connections that wait to be accepted
WATCHDOG_EVERY = 2.0  # [s]


class Address(NamedTuple):
    host: str
    port: int

    @property
    def local(self) -> bool:
        """Whether only this computer can reach the address."""
        if self.host == "localhost":
            return True
        try:
            return ipaddress.ip_address(self.host).is_loopback
        except ValueError:
            return False

    @property
    def hosts(self) -> tuple[str, ...] | None:
        """Host names that requests may have; None: any. Foreign names may resolve to this computer."""
        return (*LOCAL, self._bracketed) if self.local else None

    @property
    def _bracketed(self) -> str:
        return f"[{self.host}]" if ":" in self.host else self.host

    def written(self, port: int, *, secure: bool) -> str:
        return f"{'https' if secure else 'http'}://{self._bracketed}:{port}/"


class Tls(NamedTuple):
    """Files for TLS; `clients` is the authority of client certificates."""

    certificate: Path
    key: Path
    clients: Path | None = None


def parse_address(text: str) -> Address:
    """Parses HOST:PORT. Raises InputFaults if the text has another form."""
    host, _, port = text.rpartition(":")
    if not host or not port.isascii() or not port.isdecimal() or int(port) > 65535:
        raise InputFaults(Path("--listen"), [f"{text!r}: HOST:PORT is needed, such as 127.0.0.1:7480"])
    return Address(host.strip("[]"), int(port))


def parse_public_address(text: str) -> PublicAddress:
    """Parses the URL of the page at a reverse proxy.

    Raises:
        InputFaults: the text is no such URL.
    """
    found = re.fullmatch(r"(https?://[a-z0-9.-]+(?::\d+)?|https?://\[[0-9a-f:]+\](?::\d+)?)((?:/[\w.~-]+)*)/?", text)
    if found is None:
        raise InputFaults(
            Path("--public"), [f"{text!r}: a URL in small letters is needed, such as https://robot.local/hyperbit/"]
        )
    origin, path = found.groups()
    default = ":443" if origin.startswith("https:") else ":80"
    return PublicAddress(origin.removesuffix(default), f"{path}/")


def listening(address: Address) -> list[socket.socket]:
    """Returns a listening socket for each IP address of the host. Raises OSError if the address is not free."""
    sockets, port = list[socket.socket](), address.port
    failed: OSError | None = None
    for family, _, _, _, target in socket.getaddrinfo(address.host, port, type=socket.SOCK_STREAM):
        try:
            sockets.append(socket.create_server((str(target[0]), port), family=family, backlog=BACKLOG))
            port = sockets[0].getsockname()[1]  # one port for all, also if the system chooses it
        except OSError as error:  # IPv6 may be switched off
            failed = error if failed is None or error.errno == errno.EADDRINUSE else failed
    if failed is not None and (not sockets or failed.errno == errno.EADDRINUSE):
        for opened in sockets:
            opened.close()
        raise failed
    return sockets


def zenoh_configuration(endpoints: Sequence[str], file: Path | None) -> zenoh.Config:
    """Returns a Zenoh configuration that connects to daemons as soon as they start.

    A Zenoh client connects to one endpoint only, which must be there. So the panel is a peer that does not listen.

    Raises:
        ValueError: the file is no Zenoh configuration, or an endpoint is none.
    """
    for endpoint in () if file is not None else endpoints:
        parse_endpoint(endpoint)
    config = session.configuration("peer") if file is None else session.from_file(file)
    if file is None:
        config.insert_json5("connect/endpoints", json.dumps(list(endpoints)))
    config.insert_json5("mode", '"peer"')
    config.insert_json5("listen/endpoints", "[]")
    return config


def read_or_make_people(path: Path | None) -> tuple[list[PersonEntry], dict[str, str]]:
    """Returns the people of a file, or an operator and a viewer with new tokens; and the new tokens by name."""
    if path is not None:
        return read_people(path), {}
    tokens = {"operator": new_token(), "viewer": new_token()}
    return [
        PersonEntry("operator", "operator", digest_of(tokens["operator"])),
        PersonEntry("viewer", "viewer", digest_of(tokens["viewer"])),
    ], tokens


def serve(
    address: Address,
    tls: Tls | None,
    people: Path | None,
    config: zenoh.Config,
    prefix: str,
    public: PublicAddress | None = None,
) -> None:
    """Serves the page until a signal ends the process; prints its address once it is served.

    Raises:
        InputFaults: the file of people is wrong, or other computers could connect without TLS.
        OSError: the address is in use, or a certificate cannot be read.
    """
    if not address.local and tls is None:
        needed = "other computers can connect, so TLS is needed: give --certificate and --key"
        raise InputFaults(Path("--listen"), [f"{address.host}: {needed}"])
    listed, tokens = read_or_make_people(people)
    sockets = listening(address)
    access = Access(listed, sessions_file())
    panel = PanelServer(
        lambda: open_session(config),
        access,
        lambda opened: missing_peers(opened, config),
        prefix=prefix,
        tls=tls is not None,
        hosts=address.hosts,
        public=public,
    )
    written = None if public is None else f"{public.origin}{public.path}"
    counted: list[socket.socket] = [CountedSocket(it, panel.doors) for it in sockets]
    asyncio.run(_serve(panel, address, tls, tokens, counted, written))


async def _serve(
    panel: PanelServer,
    address: Address,
    tls: Tls | None,
    tokens: dict[str, str],
    sockets: list[socket.socket],
    public: str | None,
) -> None:
    options: dict[str, Any] = {}
    if tls is not None:
        options = {"ssl_certfile": tls.certificate, "ssl_keyfile": tls.key}
        if tls.clients is not None:
            options |= {"ssl_ca_certs": str(tls.clients), "ssl_cert_reqs": ssl.CERT_OPTIONAL}
    server = uvicorn.Server(
        uvicorn.Config(
            panel.app,
            loop="asyncio",
            http=GuardedHttp,
            ws=CertifiedWebSocket,
            ws_max_size=MOST_BYTES,
            ws_per_message_deflate=False,
            lifespan="on",
            log_config=None,
            log_level="warning",
            access_log=False,
            proxy_headers=False,
            server_header=False,
            timeout_graceful_shutdown=1,
            **options,
        )
    )
    announced = asyncio.create_task(
        _announce(server, tokens, lambda port: public or address.written(port, secure=tls is not None))
    )

    def end() -> None:
        server.should_exit = True

    end_on_signals(end)  # uvicorn handles two of the signals itself, and raises them again after its end
    await server.serve(sockets)
    announced.cancel()


async def _announce(server: uvicorn.Server, tokens: dict[str, str], written: Callable[[int], str]) -> None:
    """Waits until the page is served, prints its address with the new tokens, then feeds systemd's watchdog."""
    notifier = Notifier()
    while not server.started:
        await asyncio.sleep(0.02)
    port = server.servers[0].sockets[0].getsockname()[1]
    url = written(port)
    lines = [f"{name}: {url}#{token}" for name, token in tokens.items()] or [url]
    sys.stdout.write("".join(f"hyperbit panel, {line}\n" for line in lines))  # at once, also without a buffer
    sys.stdout.flush()
    notifier.notify("READY=1")
    notifier.notify(f"STATUS=serving at {url}")
    while True:
        notifier.notify("WATCHDOG=1")
        flush_outputs()
        await asyncio.sleep(WATCHDOG_EVERY)
