"""The page's web server: address, TLS, people, and uvicorn."""

import asyncio
import ipaddress
import json
import signal
import ssl
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import uvicorn
import zenoh
from uvicorn.protocols.http.h11_impl import H11Protocol
from uvicorn.protocols.websockets.websockets_sansio_impl import WebSocketsSansIOProtocol

from controller.armfile.strict import InputFaults
from controller.host.notify import Notifier
from controller.network import session
from controller.panel.access import Access, PersonEntry, cookie_key, digest_of, new_token, read_people
from controller.panel.app import PanelServer
from controller.panel.requests import MOST_BYTES

MOST_CONNECTIONS = 500
WATCHDOG_EVERY = 2.0  # [s]


class Address(NamedTuple):
    """Address of the page: host and port."""

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

    def written(self, port: int, *, secure: bool) -> str:
        """Returns the URL of the page."""
        host = f"[{self.host}]" if ":" in self.host else self.host
        return f"{'https' if secure else 'http'}://{host}:{port}/"


class Tls(NamedTuple):
    """Files for TLS: certificate, private key, and optionally the authority of client certificates."""

    certificate: Path
    key: Path
    clients: Path | None = None


def parse_address(text: str) -> Address:
    """Parses HOST:PORT.

    Raises:
        InputFaults: the text has another form.
    """
    host, _, port = text.rpartition(":")
    if not host or not port.isascii() or not port.isdecimal() or int(port) > 65535:
        raise InputFaults(Path("--listen"), [f"{text!r}: HOST:PORT is needed, such as 127.0.0.1:7480"])
    return Address(host.strip("[]"), int(port))


def zenoh_configuration(endpoints: Sequence[str], file: Path | None) -> zenoh.Config:
    """Returns a Zenoh configuration that connects to daemons as soon as they are there.

    A Zenoh client connects to one endpoint only, which must be there. So the panel is a peer that does not listen.

    Raises:
        ValueError: the file is no Zenoh configuration.
    """
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


def serve(address: Address, tls: Tls | None, people: Path | None, config: zenoh.Config, prefix: str) -> None:
    """Serves the page until SIGTERM or SIGINT; prints its address once it is served.

    Raises:
        InputFaults: the file of people is wrong, or other computers could connect without TLS.
        OSError: the address is in use, or a certificate cannot be read.
    """
    if not address.local and tls is None:
        needed = "other computers can connect, so TLS is needed: give --certificate and --key"
        raise InputFaults(Path("--listen"), [f"{address.host}: {needed}"])
    listed, tokens = read_or_make_people(people)
    access = Access(listed, cookie_key())
    panel = PanelServer(lambda: zenoh.open(config), access, prefix=prefix, secure=tls is not None, local=address.local)
    asyncio.run(_serve(panel, address, tls, tokens))


async def _serve(panel: PanelServer, address: Address, tls: Tls | None, tokens: dict[str, str]) -> None:
    options: dict[str, Any] = {}
    if tls is not None:
        options = {"ssl_certfile": tls.certificate, "ssl_keyfile": tls.key}
        if tls.clients is not None:
            options |= {"ssl_ca_certs": str(tls.clients), "ssl_cert_reqs": ssl.CERT_OPTIONAL}
    server = uvicorn.Server(
        uvicorn.Config(
            panel.app,
            host=address.host,
            port=address.port,
            loop="asyncio",
            http=CertifiedHttp,
            ws=CertifiedWebSocket,
            ws_max_size=MOST_BYTES,
            ws_per_message_deflate=False,
            lifespan="on",
            log_config=None,
            log_level="warning",
            access_log=False,
            proxy_headers=False,
            server_header=False,
            limit_concurrency=MOST_CONNECTIONS,
            timeout_graceful_shutdown=1,
            **options,
        )
    )
    announced = asyncio.create_task(_announce(server, address, tls is not None, tokens))
    for number in (signal.SIGTERM, signal.SIGINT):  # uvicorn raises the signal again after its end
        signal.signal(number, lambda *_: None)
    await server.serve()
    announced.cancel()


async def _announce(server: uvicorn.Server, address: Address, secure: bool, tokens: dict[str, str]) -> None:
    """Waits until the page is served, prints its address with the new tokens, then feeds systemd's watchdog."""
    notifier = Notifier()
    while not server.started:
        await asyncio.sleep(0.02)
    port = server.servers[0].sockets[0].getsockname()[1]
    url = address.written(port, secure=secure)
    lines = [f"{name}: {url}#{token}" for name, token in tokens.items()] or [url]
    for line in lines:
        sys.stdout.write(f"hyperbit panel, {line}\n")
    sys.stdout.flush()
    notifier.notify("READY=1")
    notifier.notify(f"STATUS=serving at {url}")
    while True:
        notifier.notify("WATCHDOG=1")
        await asyncio.sleep(WATCHDOG_EVERY)


def common_name(transport: Any) -> str | None:
    """Returns the common name of a connection's client certificate; None if there is none."""
    connection = transport.get_extra_info("ssl_object")
    certificate = (connection.getpeercert() if connection is not None else None) or {}
    names = [value for part in certificate.get("subject", ()) for key, value in part if key == "commonName"]
    return str(names[0]) if len(names) == 1 else None


class CertifiedHttp(H11Protocol):
    """HTTP whose connections carry the common name of the client certificate."""

    def connection_made(self, transport: Any) -> None:
        """Stores the certificate's common name."""
        super().connection_made(transport)
        self.app_state = {**self.app_state, "certificate": common_name(transport)}


class CertifiedWebSocket(WebSocketsSansIOProtocol):
    """A WebSocket whose connections carry the common name of the client certificate."""

    def connection_made(self, transport: Any) -> None:
        """Stores the certificate's common name."""
        super().connection_made(transport)
        self.app_state = {**self.app_state, "certificate": common_name(transport)}
