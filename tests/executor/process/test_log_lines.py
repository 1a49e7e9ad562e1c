"""Log lines: written at once, without blocking."""

import logging
import os
from collections.abc import Iterator

import pytest

from hyperbit.controller.executor.process.real_time import MOST_WAITING, LogLines

LONG = "x" * 10_000


class Pipe:
    def __init__(self) -> None:
        self.reading, self.writing = os.pipe()
        os.set_blocking(self.reading, False)
        self.lines, self.log = LogLines(self.writing), logging.Logger("log")
        self.log.addHandler(self.lines)

    def read(self) -> list[str]:
        """Returns the lines that can be read, those among them that can be written only now."""
        text = b""
        while more := self._read():
            text += more
            self.lines._write(0.0)
        return text.decode().splitlines()

    def _read(self) -> bytes:
        try:
            return os.read(self.reading, 1 << 20)
        except BlockingIOError:
            return b""

    def close(self) -> None:
        for number in (self.reading, self.writing):
            os.close(number)


@pytest.fixture
def pipe() -> Iterator[Pipe]:
    pipe = Pipe()
    yield pipe
    pipe.close()


def test_a_line_is_written_at_once(pipe: Pipe) -> None:
    pipe.log.info("%d boards", 3)
    assert pipe.read() == ["3 boards"]
    pipe.log.info("bytes \udcff and\na line break")
    assert pipe.read() == ["bytes \\udcff and", "a line break"]


def test_a_reader_that_hangs_is_not_waited_for(pipe: Pipe) -> None:
    for k in range(3 * MOST_WAITING):
        pipe.log.info("%d %s", k, LONG)
    heard = pipe.read()
    pipe.log.info("the last")
    assert pipe.read() == ["the last"]
    assert heard == [f"{k} {LONG}" for k in range(len(heard))]
    assert MOST_WAITING <= len(heard) < 2 * MOST_WAITING


def test_a_missing_reader_and_a_malformed_line_do_not_stop_the_loop(pipe: Pipe) -> None:
    pipe.log.info("%d", "three")
    assert pipe.read() == ["INFO log: a line cannot be written: '%d'"]
    os.close(pipe.reading)
    pipe.log.info("nobody hears this")
    pipe.lines.close()
    pipe.reading, number = os.pipe()
    os.close(number)
