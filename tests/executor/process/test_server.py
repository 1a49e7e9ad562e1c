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
from hyperbit.controller.messages.state import LoopTimes
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

TELEMETRY = Diagnostics(0.0, LoopTimes(), [], [], "off", tuple(range(3000)), 0, 0)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "folder" / "arm.sock"


@pytest.fixture
def clock() -> Clock:
    return Clock(50.0)


@pytest.fixture
def server(path: Path, clock: Clock) -> Iterator[ExecutorServer]:
    server = ExecutorServer(path, clock)
    yield server
    server.close()


class Client:
    """A client of the server; `hear` returns its next message, None at the end of the connection."""

    def __init__(self, path: Path) -> None:
        self.socket = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self.socket.settimeout(10)
        self.socket.connect(str(path))

    def __enter__(self) -> "Client":
        return self

    def __exit__(self, *_: object) -> None:
        self.socket.close()

    def send(self, *messages: Any) -> None:
        for message in messages:
            self.socket.send(message if isinstance(message, bytes) else encode(message))

    def hear(self) -> Any:
        packet = self.socket.recv(MOST_BYTES)
        return decode_up(packet) if packet else None

    @property
    def is_open(self) -> bool:
        self.socket.setblocking(False)
        try:
            return self.socket.recv(1) != b""
        except BlockingIOError:
            return True


@pytest.fixture
def client(server: ExecutorServer, path: Path) -> Iterator[Client]:
    with Client(path) as client:
        yield client


def deaf(server: ExecutorServer, client: Client) -> ClientId:
    """Returns a client that has said Hello and whose queue is full, because it does not read."""
    client.send(Hello(VERSION, "planner", ""))
    (event,) = server.poll()
    while not server.waiting:
        server.send_message(event.client, TELEMETRY)
    return event.client


def test_messages_come_in_with_their_process_and_answers_go_out(server: ExecutorServer, client: Client) -> None:
    client.send(Alive(), Stop(3))
    events = server.poll()
    assert [event.message for event in events] == [Alive(), Stop(3)]
    assert events[0].client.pid == os.getpid()
    server.send_message(events[0].client, Answer(3, "stopped"))
    assert client.hear() == Answer(3, "stopped")
    server.send_message(events[0].client, Goodbye("no"))
    assert (client.hear(), client.hear()) == (Goodbye("no"), None), "it is closed after a goodbye"
    assert server.poll() == [ClientGone(events[0].client)]
    server.send_message(events[0].client, Answer(3, "nobody"))


@pytest.mark.parametrize("packet", [b"nonsense", b"\x91\xa3abc", encode(Alive()) + b"\0", b"\0" * (MOST_BYTES + 1)])
def test_a_malformed_message_ends_the_connection_with_a_reason(
    server: ExecutorServer, client: Client, packet: bytes
) -> None:
    client.send(packet)
    (event,) = server.poll()
    assert isinstance(event, ClientGone)
    assert isinstance(client.hear(), Goodbye)
    assert client.hear() is None


def test_telemetry_is_dropped_for_who_does_not_read_and_results_wait(server: ExecutorServer, client: Client) -> None:
    identity = deaf(server, client)
    assert server.writable()
    server.send_message(identity, TELEMETRY)
    assert server.dropped == 1
    result = Ended(1, 1, b"", "done", "", 0, 0, b"", b"")
    server.send_message(identity, result)
    while not isinstance(heard := client.hear(), Ended):
        server.flush()
    assert heard == result
    server.flush()
    assert not server.waiting


def test_who_never_reads_is_disconnected_at_last(server: ExecutorServer, client: Client) -> None:
    identity = deaf(server, client)
    for _ in range(MOST_QUEUED + 1):
        server.send_message(identity, Answer(1, ""))
    assert server.poll() == [ClientGone(identity)]


def test_who_does_not_read_its_goodbye_is_closed_in_time(server: ExecutorServer, client: Client, clock: Clock) -> None:
    identity = deaf(server, client)
    server.send_message(identity, Goodbye("no"))
    clock.now += HELLO_TIMEOUT
    assert server.poll([]) == [ClientGone(identity)]


def test_floods_of_many_clients_share_what_one_poll_takes(server: ExecutorServer, path: Path) -> None:
    with ExitStack() as closing:
        clients = [closing.enter_context(Client(path)) for _ in range(8)]
        server.poll()
        for client in clients:
            client.send(*[Alive()] * 30)
        heard: list[Any] = []
        while events := server.poll():
            assert len(events) <= 64
            heard += events
        assert [sum(event.client == each for event in heard) for each in {e.client for e in heard}] == [30] * 8


def is_heard(server: ExecutorServer, path: Path, role: str) -> bool:
    """Whether a new client of a role is heard."""
    with Client(path) as client:
        server.poll()
        hello = Hello(VERSION, role, "")
        client.send(hello, Stop(1))
        return [e.message for e in server.poll() if isinstance(e, FromClient)] == [hello, Stop(1)]


@pytest.mark.parametrize("place", ["silent", "operator"])
def test_silent_connections_and_operators_keep_nobody_out(server: ExecutorServer, path: Path, place: str) -> None:
    clients = []
    for _ in range(100):
        clients.append(Client(path))
        clients[-1].send(*[Hello(VERSION, "operator", "")] * (place == "operator"))
        server.poll()
    assert sum(client.is_open for client in clients) == PLACES[place]
    assert clients[-1].is_open
    assert is_heard(server, path, "operator")
    assert is_heard(server, path, "planner")


def test_who_says_nothing_in_time_is_closed(server: ExecutorServer, path: Path, clock: Clock) -> None:
    with Client(path) as silent, Client(path) as wrong, Client(path) as client:
        wrong.send(Alive())
        client.send(Hello(VERSION, "operator", ""))
        server.poll()
        clock.now += 0.9 * HELLO_TIMEOUT
        server.poll([])
        assert [it.is_open for it in (silent, wrong, client)] == [True] * 3
        clock.now += 0.2 * HELLO_TIMEOUT
        server.poll([])
        assert [it.is_open for it in (silent, wrong, client)] == [False, False, True]


def test_a_loop_that_was_late_hears_a_hello_before_it_judges(
    server: ExecutorServer, client: Client, clock: Clock
) -> None:
    server.poll()
    client.send(Hello(VERSION, "operator", ""))
    clock.now += 60.0
    (event,) = server.poll([])
    assert isinstance(event, FromClient)
    assert client.is_open


def test_the_process_with_the_most_connections_gives_way() -> None:
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    with ours, theirs:
        connections = [ClientConnection(k, ours, 0.0) for k in range(PLACES["silent"] + 2)]
        for k, connection in enumerate(connections):
            connection.client = ClientId(k, 4000 + (k > 0))
        assert list(superfluous(connections)) == connections[1:3]


def test_a_flood_of_connections_writes_few_lines(
    server: ExecutorServer, path: Path, clock: Clock, caplog: pytest.LogCaptureFixture
) -> None:
    for k in range(200):
        with Client(path) as client:
            client.send(b"nonsense")
            server.poll()
            clock.now += 0.02 * (k < 100)
    assert 2 <= len(caplog.records) <= 3
    assert "warnings like this were not written" in caplog.text


def test_a_second_executor_hears_who_the_first_is_and_a_socket_that_cannot_be_made_is_named(
    server: ExecutorServer, path: Path
) -> None:
    with pytest.raises(FileInUse, match=f"running on {path}, process {os.getpid()}"):
        ExecutorServer(path)
    with pytest.raises(OSError, match=r"the socket .*aaa\.sock cannot be made: AF_UNIX path too long"):
        ExecutorServer(path.with_name(f"{'a' * 120}.sock"))


def test_a_stale_socket_is_replaced(path: Path) -> None:
    path.parent.mkdir()
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as old:
        old.bind(str(path))
    server = ExecutorServer(path)
    assert stat.S_IMODE(path.stat().st_mode) == 0o660
    server.close()
    assert not path.exists()


def test_where_sockets_are(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, stack: ExitStack) -> None:
    instances = tmp_path / "arms"
    monkeypatch.delenv("RUNTIME_DIRECTORY", raising=False)
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path / "user"))
    paths = [instances / instance / f"{instance}-arm.sock" for instance in ("left", "right")]
    for path in [*paths, tmp_path / "own" / "b.sock"]:
        path.parent.mkdir(parents=True)
        stack.callback(ExecutorServer(path).close)
    assert found_sockets(instances) == paths
    assert [default_socket(f"{side}-arm", instances) for side in ("left", "right")] == paths
    assert default_socket("third", instances) == tmp_path / "user/hyperbit/third.sock"
    unreadable = "x" * 300  # a name that cannot be looked at
    assert default_socket(unreadable, instances) == tmp_path / f"user/hyperbit/{unreadable}.sock"
    monkeypatch.setenv("RUNTIME_DIRECTORY", str(tmp_path / "own"))
    (tmp_path / "own" / "c.sock").touch()
    assert found_sockets(tmp_path / "none") == [tmp_path / "own" / "b.sock"]
    assert default_socket("a") == tmp_path / "own/a.sock"
    assert socket_path(tmp_path, "a") == tmp_path / "a.sock"
    assert socket_path(tmp_path / "b.sock", "a") == tmp_path / "b.sock"
