"""The connection to the executor: established, refused, lost, full, and established again."""

import os
import socket
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from hyperbit.controller.planning.core.events import FromExecutor, LinkDown
from hyperbit.controller.planning.link import MOST_BEHIND, MOST_QUEUED, RETRY, UNREAD, ExecutorLink
from hyperbit.controller.program import (
    Alive,
    Answer,
    Goodbye,
    Hello,
    PlayableFaults,
    Program,
    Snapshot,
    Stop,
    Welcome,
    encode,
)
from tests.planning.rig.executor import DIGEST, ScriptedExecutor
from tests.waiting import eventually

PROGRAM = Program(1, 1, b"", 0.0, (), True, False, "x", os.urandom(8_000))


class Line:
    """A link, its clock, and its events but snapshots."""

    def __init__(self, path: Path, digest: str = DIGEST, *, simulated: bool = False) -> None:
        self.path, self.now = path, 0.0
        self.link = ExecutorLink(path, "small", digest, lambda: self.now, simulated=simulated)
        self.events: list[FromExecutor | LinkDown] = []

    def poll(self) -> None:
        self.now += RETRY
        self.link.connect(self.now)
        self.events += [
            event
            for event in self.link.receive()
            if not (isinstance(event, FromExecutor) and isinstance(event.message, Snapshot))
        ]

    def until(self, condition: Callable[[], Any]) -> None:
        def met() -> Any:
            self.poll()
            return condition()

        eventually(met)

    def welcome(self, count: int = 1) -> None:
        self.until(lambda: sum(isinstance(message, Welcome) for message in self.messages) == count)

    @property
    def messages(self) -> list[Any]:
        return [event.message for event in self.events if isinstance(event, FromExecutor)]

    @property
    def reasons(self) -> list[str]:
        return [event.reason for event in self.events if isinstance(event, LinkDown)]


@pytest.fixture
def line(tmp_path: Path) -> Iterator[Line]:
    line = Line(tmp_path / "small.sock")
    yield line
    line.link.close()


@pytest.fixture
def executor(line: Line) -> Iterator[ScriptedExecutor]:
    executor = ScriptedExecutor(line.path, 12)
    yield executor
    executor.close()


class Deaf:
    def __init__(self, line: Line) -> None:
        self._server = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self._server.bind(str(line.path))
        self._server.listen()
        line.poll()
        self.client, _ = self._server.accept()
        self.client.send(encode(Welcome("small", DIGEST, 1, (), 0)))
        line.welcome()

    def read(self) -> list[bytes]:
        read = []
        while True:
            try:
                read.append(self.client.recv(70_000, socket.MSG_DONTWAIT))
            except BlockingIOError:
                return read

    def close(self) -> None:
        self.client.close()
        self._server.close()


@pytest.fixture
def deaf(line: Line) -> Iterator[Deaf]:
    deaf = Deaf(line)
    yield deaf
    deaf.close()


def test_a_daemon_of_a_real_arm_drives_no_simulated_boards_and_the_reverse(tmp_path: Path) -> None:
    line, executor = Line(tmp_path / "small.sock"), ScriptedExecutor(tmp_path / "small.sock", 12)
    executor.simulation = PlayableFaults((), (), (), ())
    line.until(lambda: line.reasons)
    assert line.reasons == ["the executor simulates its boards: start this daemon with --simulate, too"]
    assert line.messages == []
    line.link.close()
    line = Line(tmp_path / "small.sock", simulated=True)
    line.welcome()
    executor.simulation = None
    line.link.drop("again")
    line.until(lambda: len(line.reasons) == 2)
    assert line.reasons[1] == "the executor commands real boards: start this daemon without --simulate"
    line.link.close()
    executor.close()


def test_it_waits_for_an_executor_and_tells_the_reason_once(line: Line) -> None:
    assert line.link.send_now(Stop(1)) == "waiting for the executor"
    for _ in range(3):
        line.poll()
    assert line.reasons == ["waiting for the executor at its socket: No such file or directory"]
    assert line.link.send_now(Stop(1)) == line.reasons[0]
    executor = ScriptedExecutor(line.path, 12)
    line.link.connect(line.now + RETRY / 2)
    assert (line.link.fileno(), line.link.retry_at) == (-1, line.now + RETRY), "it tries again only after a while"
    line.welcome()
    hello = executor.expect(Hello)
    assert (hello.role, hello.arm) == ("planner", "small")
    executor.close()


@pytest.mark.parametrize(("name", "words"), [("small.sock/a", "Not a directory"), ("a" * 200, "AF_UNIX path too long")])
def test_a_path_that_cannot_be_used_is_told_once(line: Line, name: str, words: str) -> None:
    line.path.touch()
    line.link = ExecutorLink(line.path.parent / name, "small", DIGEST)
    line.poll()
    line.poll()
    assert line.reasons == [f"waiting for the executor at its socket: {words}"]


def test_it_connects_anew_when_the_executor_is_lost(line: Line, executor: ScriptedExecutor) -> None:
    line.welcome()
    executor.instance = 2
    executor.drop()
    line.welcome(2)
    assert [message.instance for message in line.messages] == [1, 2]
    assert line.events[1] == LinkDown("the executor closed the connection")


def test_what_an_executor_sent_before_its_end_is_received(line: Line, deaf: Deaf) -> None:
    line.link.send(Alive())  # which the executor does not read before it ends
    deaf.client.send(encode(Answer(1, "stopped")))
    deaf.close()
    line.link.send(Alive())
    assert line.link.send_now(Stop(2)) is not None
    line.poll()
    assert line.messages[1:] == [Answer(1, "stopped")]
    assert line.reasons == ["the executor closed the connection"]


@pytest.mark.parametrize(
    ("name", "digest", "words"),
    [("other", DIGEST, "drives the arm 'other'"), ("small", "e" * 64, "another version of the arm's file")],
)
def test_an_executor_of_another_arm_or_file_is_not_driven(tmp_path: Path, name: str, digest: str, words: str) -> None:
    line = Line(tmp_path / "small.sock", digest)
    executor = ScriptedExecutor(line.path, 12, name)
    line.until(lambda: line.reasons)
    assert words in line.reasons[0]
    for _ in range(2):
        executor.expect(Hello)
        line.until(lambda: line.link.fileno() >= 0)
    assert len(line.events) == 1
    assert words in (line.link.send_now(Stop(1)) or "")
    line.link.close()
    executor.close()


def test_what_the_executor_says_when_it_does_not_serve_is_told(line: Line, executor: ScriptedExecutor) -> None:
    executor.greets = False
    line.poll()
    executor.expect(Hello)
    executor.send(Answer(1, "before the Welcome"))
    executor.send(Goodbye("a planner is connected already"))
    executor.greets = True
    line.welcome()
    assert line.events[:-1] == [LinkDown("the executor refused this planner: a planner is connected already")]


def test_a_packet_that_is_no_message_ends_the_connection(line: Line, executor: ScriptedExecutor) -> None:
    line.welcome()
    assert executor.client is not None
    executor.client.send(b"\xff\xff")
    line.until(lambda: line.reasons)
    assert "cannot be decoded, perhaps of another version" in line.reasons[0]
    line.welcome(2)


def test_messages_arrive_in_both_directions(line: Line, executor: ScriptedExecutor) -> None:
    line.link.send(Stop(1))  # dropped
    line.welcome()
    executor.expect(Hello)
    line.link.send(Stop(2))
    assert line.link.send_now(Stop(3)) is None
    assert [executor.expect(Stop).request for _ in range(2)] == [2, 3]
    executor.send(Answer(3, "third"))
    executor.send(Answer(2, "second"))
    line.until(lambda: len(line.messages) == 3)
    assert [message.request for message in line.messages[1:]] == [3, 2]


def test_a_dropped_connection_is_told_and_made_again(line: Line, executor: ScriptedExecutor) -> None:
    line.link.drop("nothing to drop")
    line.welcome()
    line.link.drop("silent")
    assert (bool(line.link.received), line.link.fileno()) == (True, -1)
    assert line.link.send_now(Stop(1)) == "silent"
    line.welcome(2)
    assert line.reasons == ["silent"]


def fill(line: Line) -> None:
    """Sends until a message waits."""
    while not line.link.queue:
        line.link.send(PROGRAM)


def test_messages_wait_while_the_socket_is_full_and_a_stop_that_cannot_be_sent_says_so(line: Line, deaf: Deaf) -> None:
    fill(line)
    line.link.send(Stop(7))
    assert line.link.send_now(Stop(1)) == UNREAD
    assert line.events[1:] == []  # the queue decides on the connection
    deaf.read()
    line.link.flush()
    assert not line.link.queue
    assert deaf.read() == [encode(PROGRAM), encode(Stop(7))]


def test_an_executor_that_reads_late_is_dropped(line: Line, deaf: Deaf) -> None:
    fill(line)
    line.now += MOST_BEHIND
    line.link.flush()
    assert not line.link.received
    line.now += 0.1
    line.link.flush()
    assert line.link.receive() == [LinkDown(UNREAD)]
    assert not line.link.queue


def test_an_executor_that_does_not_read_is_dropped(line: Line, deaf: Deaf) -> None:
    fill(line)
    for _ in range(MOST_QUEUED):
        assert not line.link.received
        line.link.send(Alive())
    assert line.link.receive() == [LinkDown(UNREAD)]


def test_a_flood_is_received_in_parts(line: Line, deaf: Deaf, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("hyperbit.controller.planning.link.MOST_RECEIVED", 2)
    for k in range(5):
        deaf.client.send(encode(Answer(k, "")))
    assert [len(line.link.receive()) for _ in range(4)] == [2, 2, 1, 0]


def test_threads_may_send_while_connections_end(line: Line, executor: ScriptedExecutor) -> None:
    ends, failures = threading.Event(), []

    def send() -> None:
        try:
            while not ends.is_set():
                line.link.send_now(Alive())
        except Exception as error:
            failures.append(error)

    threads = [threading.Thread(target=send) for _ in range(2)]
    for thread in threads:
        thread.start()
    for count in range(1, 6):
        line.welcome(count)
        line.link.drop("silent")
    ends.set()
    for thread in threads:
        thread.join()
    assert failures == []
