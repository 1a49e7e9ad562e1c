"""Outputs that never wait: paused terminals, pipes and sockets that nobody reads, disks that hang."""

import io
import logging
import os
import pty
import select
import socket
import subprocess
import sys
import termios
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from hyperbit.controller.host import output as module
from hyperbit.controller.host.output import LAST_TIMEOUT, MOST_WAITING, Output
from tests.waiting import PATIENCE, eventually

LINE = "x" * 1_000
MANY = 3 * MOST_WAITING // len(LINE)


class Reader:
    """A reader that reads when the test says so, and a stream to it."""

    def __init__(self, kind: str) -> None:
        if kind == "terminal":
            self.reading, self.number = pty.openpty()
            termios.tcflow(self.number, termios.TCOOFF)  # as Ctrl-S does
        elif kind == "socket":
            ours, theirs = socket.socketpair()
            self.reading, self.number = ours.detach(), theirs.detach()
        else:
            self.reading, self.number = os.pipe()
        os.set_blocking(self.reading, False)
        self.terminal = kind == "terminal"
        self.output = Output(self.number)
        self.stream = io.TextIOWrapper(self.output, errors="backslashreplace", line_buffering=True)  # type: ignore[type-var]
        self.log = logging.Logger("log")
        self.log.addHandler(logging.StreamHandler(self.stream))

    def read(self, flush: Callable[[], None] = lambda: None) -> list[str]:
        """Returns all lines that can be read; `flush` is called whenever the reader has read."""
        if self.terminal:
            termios.tcflow(self.number, termios.TCOON)
        text = b""
        flush()
        while select.select([self.reading], [], [], 0.05)[0]:
            text += os.read(self.reading, 1 << 16)
            flush()
        return text.decode().splitlines()

    def close(self) -> None:
        for number in (self.reading, self.number):
            os.close(number)


@pytest.fixture(params=["pipe", "socket", "terminal"])
def reader(request: pytest.FixtureRequest) -> Iterator[Reader]:
    reader = Reader(request.param)
    yield reader
    reader.close()


def test_a_line_is_written_at_once(reader: Reader) -> None:
    reader.read()
    reader.log.info("%d boards", 3)
    assert reader.read() == ["3 boards"]
    reader.log.info("bytes \udcff and\na line break")
    assert reader.read() == ["bytes \\udcff and", "a line break"]


def test_a_reader_that_hangs_is_not_waited_for(reader: Reader) -> None:
    for k in range(MANY):
        reader.log.info("%d %s", k, LINE)
    *heard, told = reader.read(reader.stream.flush)
    assert heard == [f"{k} {LINE}" for k in range(len(heard))]
    assert told == f"WARNING output: {MANY - len(heard)} lines were dropped: nobody read them"
    assert len(LINE) * len(heard) > MOST_WAITING // 2
    reader.log.info("the last")
    assert reader.read() == ["the last"]


def test_processes_that_share_the_descriptor_still_wait(reader: Reader) -> None:
    assert os.get_blocking(reader.number)


def test_dropped_messages_are_told_where_they_are_missing() -> None:
    sent, room = list[bytes](), 0

    def send(data: bytes) -> int:
        if len(sent) == room:
            raise BlockingIOError
        sent.append(data)
        return len(data)

    backlog = module.Backlog(send, lambda count: b"%d dropped" % count)
    half = b"x" * (MOST_WAITING // 2)
    for message in (half, half, b"lost", b"lost"):
        backlog.put(message)
    room = 1
    assert backlog.flush()
    backlog.put(b"later")
    room = 4
    assert backlog.flush()
    assert sent == [half, half, b"2 dropped", b"later"]


@pytest.mark.parametrize("reader", ["pipe", "socket"], indirect=True)
def test_a_missing_reader_stops_nobody(reader: Reader) -> None:
    os.close(reader.reading)
    for _ in range(MANY):
        reader.log.info(LINE)
    reader.output.finish()
    reader.reading = os.dup(reader.number)


def test_what_prints_inside_a_write_is_written_after_it() -> None:
    """As a signal handler or a finalizer does."""
    sent = list[bytes]()

    def send(data: bytes) -> int:
        if not sent:
            sent.append(data)
            backlog.put(b"inner")
            assert backlog.flush()
        else:
            sent.append(data)
        return len(data)

    backlog = module.Backlog(send, module.dropped_line)
    backlog.put(b"outer")
    assert backlog.flush()
    assert sent == [b"outer", b"inner"]


def test_a_descriptor_that_can_only_wait_has_a_thread(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "prompt_send", lambda number: None)
    reader = Reader("pipe")
    for _ in range(MANY):
        reader.log.info(LINE)
    heard = list[str]()
    eventually(lambda: heard.extend(reader.read()) or (heard and "lines were dropped" in heard[-1]))
    assert {line for line in heard if "lines were dropped" not in line} == {LINE}
    for _ in range(MANY):
        reader.log.info(LINE)
    reader.output.finish()  # within LAST_TIMEOUT
    reader.log.info("after the end")
    reader.close()


def test_a_file_is_appended_to(tmp_path: Path) -> None:
    path = tmp_path / "log"
    path.write_text("before\n")
    file = os.open(path, os.O_WRONLY | os.O_APPEND)
    output = Output(file)
    output.write(b"after\n")
    output.finish()
    assert eventually(lambda: path.read_text() == "before\nafter\n")
    os.close(file)


PRINTING = """
import logging, sys, threading, warnings
from hyperbit.controller.host.journal import start_logging
start_logging({})
for k in range(5_000):
    logging.info("%d %s", k, "x" * 100)
    print("x" * 100)
    warnings.warn(f"warning {k}")
    print("x" * 100, file=sys.stderr)
thread = threading.Thread(target=lambda: 1 / 0)
thread.start()
thread.join()
open(sys.argv[1], "w").close()
"""


def test_nothing_that_a_process_prints_waits(tmp_path: Path) -> None:
    reading, writing = os.pipe()
    done = tmp_path / "done"
    process = subprocess.Popen([sys.executable, "-c", PRINTING, done], stdout=writing, stderr=writing)
    os.close(writing)
    assert process.wait(PATIENCE) == 0, "the end does not wait for longer than LAST_TIMEOUT either"
    assert done.exists()
    with os.fdopen(reading) as pipe:
        assert pipe.readline() == f"INFO root: 0 {'x' * 100}\n"


@pytest.mark.parametrize("to", ["file", "pipe"])
def test_threads_that_print_do_not_keep_a_process_from_its_end(tmp_path: Path, to: str) -> None:
    """The interpreter stops them at its end, also where they hold a lock."""
    code = "import threading\nfrom hyperbit.controller.host.journal import start_logging\nstart_logging({})\n"
    code += "def work():\n    while True: print('x' * 100)\n"
    code += "for _ in range(4): threading.Thread(target=work, daemon=True).start()"
    with (tmp_path / "log").open("wb") if to == "file" else open(os.devnull, "wb") as log:
        assert subprocess.run([sys.executable, "-c", code], stdout=log, timeout=PATIENCE).returncode == 0


def test_the_last_lines_reach_a_reader_that_is_slow() -> None:
    code = "from hyperbit.controller.host.journal import start_logging\nstart_logging({})\nprint('x' * 300_000 + 'end')"
    process = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True)
    assert process.communicate()[0].endswith("end\n")
    assert LAST_TIMEOUT < 2.0, "services are killed a few seconds after their end was asked for"
