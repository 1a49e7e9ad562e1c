"""Why there is no session: six causes, each with its own sentence and remedy."""

from __future__ import annotations

import errno
import json
import os
import socket
import ssl
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
import zenoh

from hyperbit.controller.network import reach
from hyperbit.controller.network.reach import (
    Cause,
    NoSession,
    certificates_of,
    diagnosis,
    ending,
    missing_peers,
    open_session,
)
from hyperbit.controller.network.session import configuration, from_file
from hyperbit.controller.panel.serve import zenoh_configuration
from tests.endpoints import free_endpoint
from tests.keys import made, openssl
from tests.waiting import PATIENCE, eventually

needs_openssl = pytest.mark.skipif(not made(), reason="openssl makes the certificates")
UNABLE = zenoh.ZError("Unable to connect to any of [Single(tcp/a:1)]! at /src/orchestrator.rs:447.")


@pytest.fixture(autouse=True)
def _short(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(reach, "ATTEMPT", 0.5)


@contextmanager
def served(serve: Callable[[socket.socket], None]) -> Iterator[str]:
    def run() -> None:
        with suppress(OSError):
            while True:
                peer, _ = server.accept()
                with peer, suppress(OSError):
                    serve(peer)

    with socket.create_server(("127.0.0.1", 0)) as server:
        thread = threading.Thread(target=run, daemon=True)
        thread.start()
        yield f"127.0.0.1:{server.getsockname()[1]}"
        server.shutdown(socket.SHUT_RDWR)
        thread.join()


def certificate(folder: Path, name: str, days: int) -> tuple[Path, Path]:
    """Makes a certificate for 127.0.0.1 that is its own authority; it ends in some days."""
    key, request, file, names = (folder / f"{name}.{end}" for end in ("key", "csr", "pem", "names"))
    names.write_text("subjectAltName=IP:127.0.0.1\n")
    openssl(
        "req",
        "-new",
        "-newkey",
        "rsa:2048",
        "-nodes",
        "-subj",
        f"/CN={name}",
        "-keyout",
        str(key),
        "-out",
        str(request),
    )
    sign = ["x509", "-req", "-in", str(request), "-signkey", str(key), "-days", str(days), "-extfile", str(names)]
    assert openssl(*sign, "-out", str(file)).returncode == 0
    return file, key


@contextmanager
def tls_server(file: Path, key: Path, clients: Path | None = None) -> Iterator[str]:
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.load_cert_chain(file, key)
    if clients is not None:
        context.verify_mode = ssl.CERT_REQUIRED
        context.load_verify_locations(clients)

    def serve(peer: socket.socket) -> None:
        peer.settimeout(2.0)
        with suppress(OSError), context.wrap_socket(peer, server_side=True) as secure:
            secure.recv(1)

    with served(serve) as place:
        yield place


def told(endpoint: str, folder: Path | None = None, **tls: object) -> NoSession:
    config = configuration("client", connect=endpoint)
    for name, value in tls.items():
        config.insert_json5(f"transport/link/tls/{name}", json.dumps(str(value)))
    return diagnosis(config, UNABLE)


def test_nobody_listens(tmp_path: Path) -> None:
    endpoint = free_endpoint()
    with pytest.raises(NoSession, match=f"nobody listens at {endpoint}") as caught:
        open_session(configuration("client", connect=endpoint))
    assert caught.value.cause is Cause.NOBODY
    assert "hyperbit run ARM.yaml" in caught.value.step
    assert told(f"unixsock-stream/{tmp_path / 'a.sock'}").cause is Cause.NOBODY


def test_missing_peers_are_those_without_a_link() -> None:
    endpoint, absent = (free_endpoint().replace("127.0.0.1", "localhost") for _ in range(2))
    with zenoh.open(configuration("peer", listen=endpoint)):
        config = zenoh_configuration([endpoint, absent, "tcp/nowhere.invalid:7447"], None)
        with zenoh.open(config) as session:
            eventually(lambda: list(session.info.links()), PATIENCE)
            first, second = missing_peers(session, config)
    assert (first.cause, second.cause) == (Cause.NOBODY, Cause.UNKNOWN_HOST)
    assert absent in str(first)


def test_an_unknown_host() -> None:
    found = told("tcp/nowhere.invalid:7447")
    assert (found.cause, "no computer is called 'nowhere.invalid'" in str(found)) == (Cause.UNKNOWN_HOST, True)


def test_a_program_that_is_silent_gives_no_answer() -> None:
    with served(lambda peer: peer.settimeout(5.0) or (peer.recv(10_000) and peer.recv(1))) as place:  # type: ignore[func-returns-value]
        found = told(f"tcp/{place}")
    assert (found.cause, "no answer from tcp/" in str(found)) == (Cause.NO_ANSWER, True)


@pytest.mark.parametrize("error", [TimeoutError(), OSError(errno.EHOSTUNREACH, "No route to host")])
def test_a_computer_that_is_away_gives_no_answer(monkeypatch: pytest.MonkeyPatch, error: OSError) -> None:
    monkeypatch.setattr(socket, "create_connection", lambda *_: (_ for _ in ()).throw(error))
    assert told("tcp/10.0.0.1:7447").cause is Cause.NO_ANSWER


def test_an_own_resource_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    error = OSError(errno.EMFILE, os.strerror(errno.EMFILE))
    monkeypatch.setattr(socket, "create_connection", lambda *_: (_ for _ in ()).throw(error))
    found = told("tcp/127.0.0.1:7447")
    assert (found.cause, str(found)) == (
        Cause.OWN,
        "this computer lacks a resource for a connection: Too many open files",
    )


def test_a_program_that_ends_the_connection_refuses() -> None:
    with served(lambda peer: peer.recv(10_000) and None) as place:  # type: ignore[func-returns-value]
        assert told(f"tcp/{place}").cause is Cause.REFUSED


@needs_openssl
def test_tls_and_tcp_are_told_apart(tmp_path: Path) -> None:
    file, key = certificate(tmp_path, "daemon", 99)
    with tls_server(file, key) as place:
        found = told(f"tcp/{place}")
        assert (found.cause, str(found)) == (Cause.TLS, f"tcp/{place} speaks TLS")
        assert f"write tls/{place}" in found.step
    with served(lambda peer: peer.recv(10_000) and None) as place:  # type: ignore[func-returns-value]
        found = told(f"tls/{place}", root_ca_certificate=file)
        assert (found.cause, str(found)) == (Cause.TLS, f"tls/{place} does not speak TLS")


@needs_openssl
def test_who_refuses_a_certificate_is_told(tmp_path: Path) -> None:
    good, old, other = (certificate(tmp_path, *each) for each in (("good", 99), ("old", -1), ("other", 99)))
    with tls_server(*old) as place:
        found = told(f"tls/{place}", root_ca_certificate=good[0])
        assert (found.cause, f"the certificate of tls/{place} is not valid" in str(found)) == (Cause.TLS, True)
    with tls_server(*good, clients=good[0]) as place:
        found = told(f"tls/{place}", root_ca_certificate=good[0])
        assert found.cause is Cause.REFUSED, "without a certificate"
        mine = {"connect_certificate": other[0], "connect_private_key": other[1]}
        found = told(f"tls/{place}", root_ca_certificate=good[0], **mine)
        assert (found.cause, "refuses the certificate of this client" in str(found)) == (Cause.REFUSED, True)
        mine = {"connect_certificate": old[0], "connect_private_key": old[1]}
        found = told(f"tls/{place}", root_ca_certificate=good[0], **mine)
        assert (found.cause, f"certificate {old[0]} ended on" in str(found)) == (Cause.TLS, True)


@needs_openssl
def test_the_end_of_a_certificate_is_told_a_month_before(tmp_path: Path) -> None:
    file, _ = certificate(tmp_path, "a", 40)
    now = datetime.now(UTC)
    config = zenoh.Config()
    names = {"connect_certificate": str(file), "listen_certificate": str(tmp_path / "missing.pem")}
    config.insert_json5("transport/link/tls", json.dumps(names))
    certificates = certificates_of(config)
    assert ending(certificates, now) == []
    (soon,) = ending(certificates, now + timedelta(days=30, hours=12))
    assert soon.startswith(f"certificate {file} ends on {now + timedelta(days=40):%Y-%m-%d}, in 9 days: renew it")
    file.unlink()  # Zenoh has read it
    (ended,) = ending(certificates, now + timedelta(days=41))
    assert " ended on " in ended


@pytest.mark.parametrize(
    ("endpoint", "cause", "words"),
    [
        ("tcp/192.0.2.1:7447", Cause.ADDRESS, "192.0.2.1 is no address of this computer"),
        ("tcp/nowhere.invalid:7447", Cause.UNKNOWN_HOST, "no computer is called 'nowhere.invalid'"),
        ("tls/127.0.0.1:0", Cause.ADDRESS, "cannot listen at tls/127.0.0.1:0: .*Missing TLS private key"),
    ],
)
def test_an_address_that_cannot_be_used_is_told(endpoint: str, cause: Cause, words: str) -> None:
    with pytest.raises(NoSession, match=words) as caught:
        open_session(configuration("peer", listen=endpoint))
    assert caught.value.cause is cause


def test_a_port_that_is_taken_is_told() -> None:
    with ExitStack() as stack:
        taken = stack.enter_context(socket.create_server(("127.0.0.1", 0)))
        with pytest.raises(NoSession, match=r"port \d+ of 127.0.0.1 is taken by"):
            open_session(configuration("peer", listen=f"tcp/127.0.0.1:{taken.getsockname()[1]}"))


def test_no_session_uses_shared_memory(tmp_path: Path) -> None:
    (file := tmp_path / "zenoh.json5").write_text('{mode: "peer", transport: {shared_memory: {enabled: true}}}')
    for config in (configuration("client", connect="tcp/127.0.0.1:7447"), from_file(file)):
        assert json.loads(config.get_json("transport/shared_memory/enabled")) is False
