"""The server in its own process: output, TLS, client certificates, and its end."""

import contextlib
import json
import re
import signal
import socket
import ssl
from collections.abc import Callable
from pathlib import Path

import httpx2
import pytest
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

from hyperbit.controller.panel.access.people import digest_of
from tests.keys import certificates, made
from tests.panel.conftest import running
from tests.waiting import PATIENCE, eventually

Hyperbit = Callable[..., tuple[int, str, str]]


def test_without_people_each_start_has_its_tokens(tmp_path: Path) -> None:
    with running(tmp_path, "--listen", "127.0.0.1:0") as (process, (operator, viewer)):
        for address, role in ((operator, "operator"), (viewer, "viewer")):
            url, token = address.split("#")
            answer = httpx2.post(f"{url}session", json={"token": token}, headers={"origin": url.rstrip("/")})
            assert answer.json()["role"] == role
        process.send(signal.SIGTERM)
        assert process.code == 0
    assert "Traceback" not in (tmp_path / "log").read_text()


@pytest.mark.skipif(not made(), reason="openssl is missing")
def test_client_certificates_take_the_place_of_tokens(tmp_path: Path) -> None:
    keys = certificates(tmp_path / "keys", "localhost", clients=("anna", "eve"))
    people = tmp_path / "people.yaml"
    people.write_text(f"people: [{{name: anna, role: operator}}, {{name: t, role: viewer, token: {digest_of('t')}}}]\n")
    words = ["--listen", "0.0.0.0:0", "--certificate", str(keys / "daemon/certificate.pem")]
    words += ["--key", str(keys / "daemon/key.pem"), "--client-ca", str(keys / "ca/certificate.pem")]
    with running(tmp_path, *words, "--people", str(people)) as (_, (address,)):
        port = int(address.rstrip("/").rpartition(":")[2])
        origin = f"https://localhost:{port}"

        def roles(client: str | None) -> str | int:
            """Returns the page's name for this client, or the close code of a refused connection."""
            context = ssl.create_default_context(cafile=keys / "ca/certificate.pem")
            if client is not None:
                context.load_cert_chain(keys / client / "certificate.pem", keys / client / "key.pem")
            with connect(f"wss://localhost:{port}/live", ssl=context, origin=origin, open_timeout=PATIENCE) as live:  # type: ignore[arg-type]
                try:
                    while True:
                        for part in json.loads(live.recv(PATIENCE)):
                            if part["section"] == "you":
                                return str(part["role"])
                except ConnectionClosed as closed:
                    return closed.rcvd.code if closed.rcvd else 0

        assert roles("anna") == "operator"
        assert roles("eve") == 4401, "certified, but not listed"
        assert roles(None) == 4401
        context = ssl.create_default_context(cafile=keys / "ca/certificate.pem")
        answer = httpx2.post(f"{origin}/session", json={"token": "t"}, headers={"origin": origin}, verify=context)
        assert answer.json()["role"] == "viewer"
        parts = {part.strip().lower() for part in answer.headers["set-cookie"].split(";")}
        assert {"secure", "httponly", "samesite=strict", "path=/"} <= parts
        assert answer.headers["set-cookie"].startswith("__Host-hyperbit=")
        assert "strict-transport-security" not in answer.headers, "it would also bind other ports of this host"
        with pytest.raises(httpx2.RemoteProtocolError):
            httpx2.get(f"http://localhost:{port}/")


def test_slow_requests_are_closed_and_pages_stay_open(tmp_path: Path) -> None:
    """Takes longer than the 10 s in which the server waits for a request."""
    host = b"Host: 127.0.0.1\r\n"
    begins = [
        b"",
        b"GET / HTTP/1.1\r\nHost: 127",
        b"POST /session HTTP/1.1\r\nContent-Length: 100\r\nOrigin: http://127.0.0.1\r\n" + host + b"\r\n{",
        b"GET /favicon.ico HTTP/1.1\r\n" + host + b"\r\nGET / HTTP/1.1\r\nHost: 127",
    ]
    with running(tmp_path, "--listen", "127.0.0.1:0") as (_, (operator, _viewer)), contextlib.ExitStack() as closing:
        url, token = operator.rstrip("/").split("/#")
        answer = httpx2.post(f"{url}/session", json={"token": token}, headers={"origin": url})
        cookie = {"cookie": answer.headers["set-cookie"].partition(";")[0]}
        origin, live_url = url, url.replace("http", "ws") + "/live"
        live = closing.enter_context(connect(live_url, origin=origin, additional_headers=cookie, open_timeout=PATIENCE))  # type: ignore[arg-type]
        port = int(url.rpartition(":")[2])
        slow = [closing.enter_context(socket.create_connection(("127.0.0.1", port))) for _ in begins]
        for connection, begin in zip(slow, begins, strict=True):
            connection.sendall(begin)
            connection.settimeout(0.1)

        def closed(connection: socket.socket) -> bool:
            """Sends one more byte; returns whether the server has closed the connection."""
            try:
                connection.sendall(b"x")
                while connection.recv(4096):
                    pass
            except TimeoutError:
                return False
            except OSError:
                pass
            return True

        def all_closed() -> bool:
            """Reads the page's next message; returns whether all slow connections are closed."""
            assert live.recv(PATIENCE)
            slow[:] = [connection for connection in slow if not closed(connection)]
            return not slow

        eventually(all_closed)
        for _ in range(3):
            assert live.recv(PATIENCE)


@pytest.mark.parametrize("host", ["127.0.0.2", "localhost"])
def test_the_printed_address_answers(tmp_path: Path, host: str) -> None:
    with running(tmp_path, "--listen", f"{host}:0") as (_, addresses):
        url = addresses[0].partition("#")[0]
        assert url.startswith(f"http://{host}:")
        assert httpx2.get(url).status_code == 200
        assert httpx2.get(url, headers={"host": "evil.example"}).status_code == 400


def test_a_port_in_use_is_told_with_the_way_out(hyperbit: Hyperbit) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        address = f"127.0.0.1:{taken.getsockname()[1]}"
        code, _, err = hyperbit("panel", "--listen", address)
    assert code == 1
    assert f"the page cannot be served at {address}: Address already in use" in " ".join(err.split())
    assert "--panel 7481" in err
    assert "Errno" not in err


def test_bad_options_are_named(hyperbit: Hyperbit, tmp_path: Path) -> None:
    for words, sentence in (
        (["--listen", "0.0.0.0:0"], "TLS is needed"),
        (["--certificate", "c.pem"], "--certificate and --key go together"),
        (["--people", str(tmp_path / "nobody.yaml")], "no such file"),
    ):
        code, _, err = hyperbit("panel", *words)
        assert (code, sentence in " ".join(err.split())) == (2, True), err
    _, out, _ = hyperbit("panel", "--new-token", "anna")
    token = re.findall(r"token of anna: (\S+)", out)[0]
    assert digest_of(token) in "".join(out.split())
