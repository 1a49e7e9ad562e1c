"""The executor's socket: messages in both directions, and refused clients."""

import os
import socket
import stat
from collections.abc import Iterator
from pathlib import Path

import pytest

from controller.executor.events import ClientGone, FromClient
from controller.executor.server import MOST_CLIENTS, MOST_QUEUED, Server, SocketInUse
from controller.program import (
    MOST_BYTES,
    Alive,
    Answer,
    Diagnostics,
    Ended,
    Goodbye,
    Halt,
    decode_up,
    encode,
)
from controller.sockets import default_socket, found_sockets, socket_path

TELEMETRY = Diagnostics(0.0, {}, [], [], "off", tuple(range(3000)), 0, 0)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "folder" / "arm.sock"


@pytest.fixture
def server(path: Path) -> Iterator[Server]:
    server = Server(path)
    yield server
    server.close()


def connected(path: Path) -> socket.socket:
    client = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    client.settimeout(10)
    client.connect(str(path))
    return client


def test_messages_come_in_with_their_process_and_answers_go_out(server: Server, path: Path) -> None:
    with connected(path) as client:
        client.send(encode(Alive()))
        client.send(encode(Halt(3)))
        events = server.poll()
        assert [event.message for event in events] == [Alive(), Halt(3)]
        assert events[0].client.pid == os.getpid()
        server.send(events[0].client, Answer(3, True, "stopped"))
        assert decode_up(client.recv(MOST_BYTES)) == Answer(3, True, "stopped")
    assert server.poll() == [ClientGone(events[0].client)]
    server.send(events[0].client, Answer(3, True, "nobody"))


@pytest.mark.parametrize("packet", [b"nonsense", b"\x91\xa3abc", encode(Alive()) + b"\0", b"\0" * (MOST_BYTES + 1)])
def test_a_malformed_message_ends_the_connection_with_a_reason(server: Server, path: Path, packet: bytes) -> None:
    with connected(path) as client:
        client.send(packet)
        (event,) = server.poll()
        assert isinstance(event, ClientGone)
        assert isinstance(decode_up(client.recv(MOST_BYTES)), Goodbye)
        assert client.recv(1) == b""


def test_a_client_is_closed_after_a_goodbye(server: Server, path: Path) -> None:
    with connected(path) as client:
        client.send(encode(Alive()))
        (event,) = server.poll()
        server.send(event.client, Goodbye("no"))
        assert decode_up(client.recv(MOST_BYTES)) == Goodbye("no")
        assert client.recv(1) == b""
    assert server.poll() == [ClientGone(event.client)]


def test_telemetry_is_dropped_for_who_does_not_read_and_results_wait(server: Server, path: Path) -> None:
    with connected(path) as client:
        client.send(encode(Alive()))
        (event,) = server.poll()
        while not server.waiting:
            server.send(event.client, TELEMETRY)
        assert server.writable()
        server.send(event.client, TELEMETRY)
        assert server.dropped == 1
        result = Ended(1, 1, b"", "done", "", 0, 0, b"", b"")
        server.send(event.client, result)
        heard = []
        while not heard or not isinstance(heard[-1], Ended):
            heard.append(decode_up(client.recv(MOST_BYTES)))
            server.flush()
        assert heard[-1] == result
        assert not server.waiting


def test_who_never_reads_is_disconnected_at_last(server: Server, path: Path) -> None:
    with connected(path) as client:
        client.send(encode(Alive()))
        (event,) = server.poll()
        while not server.waiting:
            server.send(event.client, TELEMETRY)
        for _ in range(MOST_QUEUED + 1):
            server.send(event.client, Answer(1, True, ""))
        assert server.poll() == [ClientGone(event.client)]


def test_a_flood_does_not_stop_the_caller(server: Server, path: Path) -> None:
    with connected(path) as client:
        client.setblocking(False)
        sent = 0
        try:
            while sent < 1000:
                client.send(encode(Alive()))
                sent += 1
        except BlockingIOError:
            pass
        heard = 0
        while events := server.poll():
            assert len(events) <= 64
            heard += len(events)
        assert heard == sent


def test_only_so_many_clients(server: Server, path: Path) -> None:
    clients = []
    for _ in range(MOST_CLIENTS + 1):
        clients.append(connected(path))
        server.poll()
    assert clients[-1].recv(1) == b""
    for client in clients:
        client.close()
    assert len([e for e in server.poll() if isinstance(e, ClientGone)]) == MOST_CLIENTS
    with connected(path) as client:
        client.send(encode(Alive()))
        assert isinstance(server.poll()[0], FromClient)


def test_a_second_executor_hears_who_the_first_is(server: Server, path: Path) -> None:
    with pytest.raises(SocketInUse, match=f"running on {path}, process {os.getpid()}"):
        Server(path)


def test_a_stale_socket_is_replaced(path: Path) -> None:
    path.parent.mkdir()
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as old:
        old.bind(str(path))
    server = Server(path)
    assert stat.S_IMODE(path.stat().st_mode) == 0o660
    server.close()
    assert not path.exists()


def test_where_sockets_are(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr("controller.sockets.SYSTEM", tmp_path / "run")
    monkeypatch.setattr("controller.sockets.INSTANCES", tmp_path / "arms")
    monkeypatch.delenv("RUNTIME_DIRECTORY", raising=False)
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path / "user"))
    assert default_socket("a") == tmp_path / "user/hyperbit/a.sock"
    (tmp_path / "run").mkdir()
    assert default_socket("a") == tmp_path / "run/a.sock"
    monkeypatch.setenv("RUNTIME_DIRECTORY", str(tmp_path / "own"))
    assert default_socket("a") == tmp_path / "own/a.sock"
    assert socket_path(tmp_path, "a") == tmp_path / "a.sock"
    assert socket_path(tmp_path / "b.sock", "a") == tmp_path / "b.sock"
    server = Server(tmp_path / "run" / "b.sock")
    (tmp_path / "run" / "c.sock").touch()
    assert found_sockets() == [tmp_path / "run" / "b.sock"]
    server.close()


def test_sockets_of_instances_are_found(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr("controller.sockets.SYSTEM", tmp_path / "run")
    monkeypatch.setattr("controller.sockets.INSTANCES", tmp_path / "arms")
    monkeypatch.delenv("RUNTIME_DIRECTORY", raising=False)
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path / "user"))
    paths = [tmp_path / "arms" / instance / f"{instance}-arm.sock" for instance in ("left", "right")]
    for path in paths:
        path.parent.mkdir(parents=True)
    servers = [Server(path) for path in paths]
    assert found_sockets() == paths
    assert [default_socket("left-arm"), default_socket("right-arm")] == paths
    assert default_socket("third") == tmp_path / "user/hyperbit/third.sock"
    for server in servers:
        server.close()


def test_folders_that_a_user_may_not_read_hide_their_sockets(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr("controller.sockets.SYSTEM", tmp_path / ("x" * 300))  # a name that cannot be looked at
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path / "user"))
    assert default_socket("a") == tmp_path / "user/hyperbit/a.sock"
