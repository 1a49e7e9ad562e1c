"""The connection to the executor: established, refused, lost, and established again."""

import os
import socket
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from controller.planning.connection import NotConnected
from controller.planning.link import ExecutorLink
from controller.program import Alive, Answer, Goodbye, Halt, Hello, Program, Snapshot, Welcome, encode
from tests.planning.executor import DIGEST, ScriptedExecutor
from tests.waiting import PATIENCE, eventually


class Heard:
    """Remembers the link's messages."""

    def __init__(self) -> None:
        self.told: list[Any] = []

    def welcomed(self, welcome: Welcome) -> None:
        self.told.append(welcome)

    def heard(self, message: Any) -> None:
        if not isinstance(message, Snapshot):
            self.told.append(message)

    def lost(self, reason: str) -> None:
        self.told.append(reason)


class Line:
    def __init__(self, path: Path) -> None:
        self.path, self.heard = path, Heard()
        self.link = ExecutorLink(lambda: path, "small", DIGEST)

    def start(self) -> None:
        self.link.start(self.heard)


@pytest.fixture
def line(tmp_path: Path) -> Iterator[Line]:
    line = Line(tmp_path / "small.sock")
    yield line
    line.link.close()


def test_it_waits_for_an_executor_and_is_welcomed(line: Line) -> None:
    line.start()
    eventually(lambda: "waiting for the executor at its socket" in (line.link.problem or ""))
    with pytest.raises(NotConnected):
        line.link.send(Alive())
    executor = ScriptedExecutor(line.path, 12)
    hello = executor.expect(Hello)
    assert (hello.role, hello.arm) == ("planner", "small")
    eventually(lambda: line.link.snapshot)
    assert (line.link.connected, line.link.problem) == (True, None)
    executor.close()


def test_it_connects_anew_when_the_executor_is_lost(line: Line) -> None:
    executor = ScriptedExecutor(line.path, 12)
    line.start()
    executor.expect(Hello)
    eventually(lambda: line.link.snapshot)
    executor.instance = 2
    executor.drop()
    executor.expect(Hello)
    eventually(lambda: len(line.heard.told) == 3)
    first, lost, second = line.heard.told
    assert (first.instance, lost, second.instance) == (1, "the executor closed the connection", 2)
    executor.close()


@pytest.mark.parametrize(
    ("name", "digest", "words"),
    [("other", DIGEST, "drives the arm 'other'"), ("small", "e" * 64, "another version of the arm's file")],
)
def test_an_executor_of_another_arm_or_file_is_not_driven(line: Line, name: str, digest: str, words: str) -> None:
    executor = ScriptedExecutor(line.path, 12, name)
    line.link._digest = digest
    line.start()
    eventually(lambda: words in (line.link.problem or ""))
    assert not line.link.connected
    assert line.heard.told == []
    executor.close()


def test_what_the_executor_says_when_it_does_not_serve_is_told(line: Line) -> None:
    executor = ScriptedExecutor(line.path, 12)
    executor.greets = False
    line.start()
    executor.expect(Hello)
    executor.send(Goodbye("a planner is connected already"))
    eventually(lambda: "a planner is connected already" in (line.link.problem or ""))
    executor.greets = True
    eventually(lambda: line.link.connected)
    executor.close()


def test_a_packet_that_is_no_message_ends_the_connection(line: Line) -> None:
    executor = ScriptedExecutor(line.path, 12)
    line.start()
    executor.expect(Hello)
    eventually(lambda: line.link.snapshot)
    assert executor._client is not None
    executor._client.send(b"\xff\xff")
    eventually(lambda: any("cannot be decoded" in str(told) for told in line.heard.told))
    eventually(lambda: line.link.connected)
    executor.close()


def test_each_request_gets_its_answer_and_none_when_the_executor_dies(line: Line) -> None:
    executor = ScriptedExecutor(line.path, 12)
    line.start()
    executor.expect(Hello)
    eventually(lambda: line.link.snapshot)
    answers: list[tuple[str, Answer | None]] = []
    for name in ("a", "b", "c"):
        line.link.ask(Halt, lambda answer, name=name: answers.append((name, answer)))  # type: ignore[misc]
    first, second, _ = (executor.expect(Halt) for _ in range(3))
    executor.send(Answer(second.request, True, "second"))
    executor.send(Answer(first.request, True, "first"))
    executor.send(Answer(99, True, "nobody's"))
    eventually(lambda: len(answers) == 2)
    assert [(name, answer and answer.message) for name, answer in answers] == [("b", "second"), ("a", "first")]
    assert line.link.waiting == 1
    executor.drop()
    eventually(lambda: len(answers) == 3)
    assert answers[2] == ("c", None)
    executor.close()


def test_an_executor_that_does_not_read_is_dropped(tmp_path: Path) -> None:
    line = Line(tmp_path / "small.sock")
    server = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    server.bind(str(line.path))
    server.listen()
    line.start()
    client, _ = server.accept()
    client.send(encode(Welcome(1, "small", DIGEST, 1, (), 0)))
    eventually(lambda: line.link.connected)
    program = Program(1, 1, b"", 0.0, (), True, False, "x", os.urandom(8_000))

    def flood() -> None:
        while True:
            line.link.send(program)

    with pytest.raises(NotConnected, match="does not read"):
        flood()
    eventually(lambda: len(line.heard.told) == 2)
    line.link.close()
    server.close()
    client.close()


def test_closing_ends_the_threads(line: Line) -> None:
    executor = ScriptedExecutor(line.path, 12)
    line.start()
    executor.expect(Hello)
    line.link.close(PATIENCE)
    assert not any(thread.is_alive() for thread in line.link._threads)
    executor.close()
