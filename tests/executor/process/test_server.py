"""The executor's socket: messages in both directions, and refused clients."""

import os
import socket
import stat
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest

from hyperbit.controller.executor.core.events import ClientGone, ClientId, FromClient
from hyperbit.controller.executor.process.server import (
    HELLO_TIMEOUT,
    MOST_QUEUED,
    PLACES,
    ClientConnection,
    ExecutorServer,
    superfluous,
)
from hyperbit.controller.host.keeper import FileInUse
from hyperbit.controller.host.sockets import default_socket, found_sockets, socket_path
from hyperbit.controller.program import (
    MOST_BYTES,
    VERSION,
    Alive,
    Answer,
    Diagnostics,
    Ended,
    Goodbye,
    Hello,
    Stop,
    decode_up,
    encode,
)
from tests.clock import Clock

TELEMETRY = Diagnostics(0.0, {}, [], [], "off", tuple(range(3000)), 0, 0)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "folder" / "arm.sock"


@pytest.fixture
def server(path: Path) -> Iterator[ExecutorServer]:
    server = ExecutorServer(path)
    yield server
    server.close()


def connected(path: Path) -> socket.socket:
    client = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    client.settimeout(10)
    client.connect(str(path))
    return client


def test_messages_come_in_with_their_process_and_answers_go_out(server: ExecutorServer, path: Path) -> None:
    with connected(path) as client:
        client.send(encode(Alive()))
        client.send(encode(Stop(3)))
        events = server.poll()
        assert [event.message for event in events] == [Alive(), Stop(3)]
        assert events[0].client.pid == os.getpid()
        server.send_message(events[0].client, Answer(3, "stopped"))
        assert decode_up(client.recv(MOST_BYTES)) == Answer(3, "stopped")
    assert server.poll() == [ClientGone(events[0].client)]
    server.send_message(events[0].client, Answer(3, "nobody"))


@pytest.mark.parametrize("packet", [b"nonsense", b"\x91\xa3abc", encode(Alive()) + b"\0", b"\0" * (MOST_BYTES + 1)])
def test_a_malformed_message_ends_the_connection_with_a_reason(
    server: ExecutorServer, path: Path, packet: bytes
) -> None:
    with connected(path) as client:
        client.send(packet)
        (event,) = server.poll()
        assert isinstance(event, ClientGone)
        assert isinstance(decode_up(client.recv(MOST_BYTES)), Goodbye)
        assert client.recv(1) == b""


def test_a_client_is_closed_after_a_goodbye(server: ExecutorServer, path: Path) -> None:
    with connected(path) as client:
        client.send(encode(Alive()))
        (event,) = server.poll()
        server.send_message(event.client, Goodbye("no"))
        assert decode_up(client.recv(MOST_BYTES)) == Goodbye("no")
        assert client.recv(1) == b""
    assert server.poll() == [ClientGone(event.client)]


def test_telemetry_is_dropped_for_who_does_not_read_and_results_wait(server: ExecutorServer, path: Path) -> None:
    with connected(path) as client:
        client.send(encode(Alive()))
        (event,) = server.poll()
        while not server.waiting:
            server.send_message(event.client, TELEMETRY)
        assert server.writable()
        server.send_message(event.client, TELEMETRY)
        assert server.dropped == 1
        result = Ended(1, 1, b"", "done", "", 0, 0, b"", b"")
        server.send_message(event.client, result)
        heard = []
        while not heard or not isinstance(heard[-1], Ended):
            heard.append(decode_up(client.recv(MOST_BYTES)))
            server.flush()
        assert heard[-1] == result
        assert not server.waiting


def test_who_never_reads_is_disconnected_at_last(server: ExecutorServer, path: Path) -> None:
    with connected(path) as client:
        client.send(encode(Alive()))
        (event,) = server.poll()
        while not server.waiting:
            server.send_message(event.client, TELEMETRY)
        for _ in range(MOST_QUEUED + 1):
            server.send_message(event.client, Answer(1, ""))
        assert server.poll() == [ClientGone(event.client)]


def test_a_flood_does_not_stop_the_caller(server: ExecutorServer, path: Path) -> None:
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


def test_floods_of_many_clients_share_what_one_poll_takes(server: ExecutorServer, path: Path) -> None:
    with ExitStack() as closing:
        clients = [closing.enter_context(connected(path)) for _ in range(8)]
        server.poll()
        for client in clients:
            for _ in range(30):
                client.send(encode(Alive()))
        heard: list[Any] = []
        while events := server.poll():
            assert len(events) <= 64
            heard += events
        assert [sum(event.client == each for event in heard) for each in {e.client for e in heard}] == [30] * 8


@pytest.fixture
def clock() -> Clock:
    return Clock(50.0)


@pytest.fixture
def timed(path: Path, clock: Clock) -> Iterator[ExecutorServer]:
    server = ExecutorServer(path, clock)
    yield server
    server.close()


def is_open(client: socket.socket) -> bool:
    client.setblocking(False)
    try:
        return client.recv(1) != b""
    except BlockingIOError:
        return True


def halted(server: ExecutorServer, path: Path, role: str = "operator") -> bool:
    """Whether a new client of a role is heard."""
    with connected(path) as client:
        server.poll()
        client.send(encode(Hello(VERSION, role, "")))
        client.send(encode(Stop(1)))
        return [e.message for e in server.poll() if isinstance(e, FromClient)] == [Hello(VERSION, role, ""), Stop(1)]


def test_silent_connections_keep_nobody_out(timed: ExecutorServer, path: Path) -> None:
    silent = []
    for _ in range(100):
        silent.append(connected(path))
        timed.poll()
    assert sum(map(is_open, silent)) == PLACES["silent"]
    assert halted(timed, path)
    assert halted(timed, path, "planner")


def test_operators_keep_neither_operators_nor_the_planner_out(timed: ExecutorServer, path: Path) -> None:
    operators = []
    for _ in range(100):
        operators.append(connected(path))
        operators[-1].send(encode(Hello(VERSION, "operator", "")))
        timed.poll()
    assert sum(map(is_open, operators)) == PLACES["operator"]
    assert is_open(operators[-1])
    assert halted(timed, path)
    assert halted(timed, path, "planner")


def test_who_says_nothing_in_time_is_closed(timed: ExecutorServer, path: Path, clock: Clock) -> None:
    with connected(path) as silent, connected(path) as wrong, connected(path) as client:
        wrong.send(encode(Alive()))
        client.send(encode(Hello(VERSION, "operator", "")))
        timed.poll()
        clock.now += 0.9 * HELLO_TIMEOUT
        timed.poll([])
        assert [is_open(it) for it in (silent, wrong, client)] == [True] * 3
        clock.now += 0.2 * HELLO_TIMEOUT
        timed.poll([])
        assert [is_open(it) for it in (silent, wrong, client)] == [False, False, True]


def test_a_loop_that_was_late_hears_a_hello_before_it_judges(timed: ExecutorServer, path: Path, clock: Clock) -> None:
    with connected(path) as client:
        timed.poll()
        client.send(encode(Hello(VERSION, "operator", "")))
        clock.now += 60.0
        (event,) = timed.poll([])
        assert isinstance(event, FromClient)
        assert is_open(client)


def test_who_does_not_read_its_goodbye_is_closed_in_time(timed: ExecutorServer, path: Path, clock: Clock) -> None:
    with connected(path) as client:
        client.send(encode(Hello(VERSION, "planner", "")))
        (event,) = timed.poll()
        while not timed.waiting:
            timed.send_message(event.client, TELEMETRY)
        timed.send_message(event.client, Goodbye("no"))
        clock.now += HELLO_TIMEOUT
        assert timed.poll([]) == [ClientGone(event.client)]


def test_the_process_with_the_most_connections_gives_way() -> None:
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    with ours, theirs:
        connections = [ClientConnection(k, ours, 0.0) for k in range(PLACES["silent"] + 2)]
        for k, connection in enumerate(connections):
            connection.client = ClientId(k, 4000 + (k > 0))
        assert list(superfluous(connections)) == connections[1:3]


def test_a_flood_of_connections_writes_few_lines(
    timed: ExecutorServer, path: Path, clock: Clock, caplog: pytest.LogCaptureFixture
) -> None:
    for k in range(200):
        with connected(path) as client:
            client.send(b"nonsense")
            timed.poll()
            clock.now += 0.02 * (k < 100)
    assert 2 <= len(caplog.records) <= 3
    assert "warnings like this were not written" in caplog.text


def test_a_second_executor_hears_who_the_first_is(server: ExecutorServer, path: Path) -> None:
    with pytest.raises(FileInUse, match=f"running on {path}, process {os.getpid()}"):
        ExecutorServer(path)


def test_a_stale_socket_is_replaced(path: Path) -> None:
    path.parent.mkdir()
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as old:
        old.bind(str(path))
    server = ExecutorServer(path)
    assert stat.S_IMODE(path.stat().st_mode) == 0o660
    server.close()
    assert not path.exists()


def test_where_sockets_are(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr("hyperbit.controller.host.sockets.INSTANCES", tmp_path / "arms")
    monkeypatch.delenv("RUNTIME_DIRECTORY", raising=False)
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path / "user"))
    assert default_socket("a") == tmp_path / "user/hyperbit/a.sock"
    monkeypatch.setenv("RUNTIME_DIRECTORY", str(tmp_path / "own"))
    assert default_socket("a") == tmp_path / "own/a.sock"
    assert socket_path(tmp_path, "a") == tmp_path / "a.sock"
    assert socket_path(tmp_path / "b.sock", "a") == tmp_path / "b.sock"
    (tmp_path / "own").mkdir()
    server = ExecutorServer(tmp_path / "own" / "b.sock")
    (tmp_path / "own" / "c.sock").touch()
    assert found_sockets() == [tmp_path / "own" / "b.sock"]
    server.close()


def test_sockets_of_instances_are_found(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr("hyperbit.controller.host.sockets.INSTANCES", tmp_path / "arms")
    monkeypatch.delenv("RUNTIME_DIRECTORY", raising=False)
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path / "user"))
    paths = [tmp_path / "arms" / instance / f"{instance}-arm.sock" for instance in ("left", "right")]
    for path in paths:
        path.parent.mkdir(parents=True)
    servers = [ExecutorServer(path) for path in paths]
    assert found_sockets() == paths
    assert [default_socket("left-arm"), default_socket("right-arm")] == paths
    assert default_socket("third") == tmp_path / "user/hyperbit/third.sock"
    for server in servers:
        server.close()


def test_folders_that_a_user_may_not_read_hide_their_sockets(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    (tmp_path / "arms" / "one").mkdir(parents=True)
    monkeypatch.setattr("hyperbit.controller.host.sockets.INSTANCES", tmp_path / "arms")
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path / "user"))
    arm = "x" * 300  # a name that cannot be looked at
    assert default_socket(arm) == tmp_path / f"user/hyperbit/{arm}.sock"


def test_a_socket_that_cannot_be_made_is_named(tmp_path):
    path = tmp_path / f"{'a' * 120}.sock"
    with pytest.raises(OSError, match=r"the socket .*aaa\.sock cannot be made: AF_UNIX path too long"):
        ExecutorServer(path)
