"""Log lines for the journal: its native protocol, fields, and a socket that never blocks."""

import logging
import socket
from collections.abc import Iterator
from pathlib import Path

import pytest

from hyperbit.controller.host import journal
from hyperbit.controller.host.journal import (
    JournalHandler,
    fields_of_fault,
    fields_of_mode,
    fields_of_result,
    is_journal,
    message_id,
)
from hyperbit.controller.host.output import MOST_WAITING

LONG = "x" * 10_000


class Others(logging.Handler):
    def __init__(self) -> None:
        super().__init__()
        self.texts: list[str] = []

    def emit(self, record: logging.LogRecord) -> None:
        self.texts.append(record.getMessage() if record.args != ("x",) else "malformed")


class Journal:
    def __init__(self, folder: Path) -> None:
        self.path = folder / "socket"
        self.socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_NONBLOCK)
        self.socket.bind(str(self.path))
        self.others, self.log = Others(), logging.Logger("hyper.bit")
        self.handler = JournalHandler(self.others, {"HYPERBIT_ARM": "a"}, str(self.path))
        self.log.addHandler(self.handler)

    def read(self) -> list[dict[str, str]]:
        found = []
        while True:
            try:
                found.append(parse(self.socket.recv(1 << 20)))
            except BlockingIOError:
                return found


def parse(data: bytes) -> dict[str, str]:
    """The fields of a datagram, as the journal reads them."""
    fields = {}
    while data:
        name, _, rest = data.partition(b"\n")
        if b"=" in name:
            key, _, value = name.partition(b"=")
        else:
            size = int.from_bytes(rest[:8], "little")
            key, value, rest = name, rest[8 : 8 + size], rest[9 + size :]
        fields[key.decode()], data = value.decode(), rest
    return fields


@pytest.fixture
def taken(tmp_path: Path) -> Iterator[Journal]:
    taken = Journal(tmp_path)
    yield taken
    taken.handler.close()
    taken.socket.close()


def test_a_line_has_its_fields(taken: Journal) -> None:
    taken.log.error("board %s is lost", "can0/3", extra={"journal": fields_of_fault("board-lost", "can0/3")})
    (line,) = taken.read()
    assert line["MESSAGE"] == "board can0/3 is lost"
    assert (line["PRIORITY"], line["HYPERBIT_ARM"], line["SYSLOG_IDENTIFIER"]) == ("3", "a", "hyperbit")
    assert (line["HYPERBIT_BUS"], line["HYPERBIT_BOARD"], line["HYPERBIT_FAULT"]) == ("can0", "3", "board-lost")
    assert (line["LOGGER"], line["CODE_FUNC"]) == ("hyper.bit", "test_a_line_has_its_fields")
    assert line["MESSAGE_ID"] == message_id("board-lost")
    assert len(line["MESSAGE_ID"]) == 32
    assert taken.others.texts == []


def test_lines_and_surrogates_and_tracebacks_are_taken(taken: Journal) -> None:
    taken.log.info("two\nlines\udcff = 1")
    try:
        raise RuntimeError("a defect")
    except RuntimeError:
        taken.log.exception("failed")
    taken.log.warning("x" * 1_000_000)
    first, second, third = taken.read()
    assert first["MESSAGE"] == "two\nlines\\udcff = 1"
    assert second["MESSAGE"].startswith("failed\nTraceback")
    assert second["MESSAGE"].endswith("RuntimeError: a defect")
    assert 50_000 < len(third["MESSAGE"]) < 100_000
    assert [line["PRIORITY"] for line in (first, second, third)] == ["6", "3", "4"]


def test_a_journal_that_hangs_is_not_waited_for(taken: Journal) -> None:
    count = 3 * MOST_WAITING // len(LONG)
    for k in range(count):
        taken.log.info("%d %s", k, LONG)
    heard = taken.read()
    while more := (taken.handler.flush(), taken.read())[1]:
        heard += more
    *texts, told = [line["MESSAGE"] for line in heard]
    assert texts == [f"{k} {LONG}" for k in range(len(texts))]
    assert told == f"{count - len(texts)} lines were dropped: the journal did not read them"
    assert heard[-1]["HYPERBIT_ARM"] == "a"
    assert taken.others.texts == []


def test_without_a_journal_lines_go_elsewhere(taken: Journal) -> None:
    taken.socket.close()
    taken.log.info("nobody reads")
    taken.path.unlink()
    taken.log.info("no socket")
    taken.log.info("%d", "x")
    assert taken.others.texts == ["nobody reads", "no socket", "malformed"]


@pytest.mark.parametrize(
    ("code", "source", "fields"),
    [
        ("board-lost", "can0/5", {"BUS": "can0", "BOARD": "5"}),
        ("stuck", "5.left (can1/7 output 0)", {"ACTUATOR": "5.left", "BUS": "can1", "BOARD": "7"}),
        ("unexpected-motion", "12.1", {"ACTUATOR": "12.1"}),
        ("bus-off", "can0", {"BUS": "can0"}),
        ("interlock", "emergency_stop (can0/9 input 0)", {"BUS": "can0", "BOARD": "9"}),
        ("executor-lost", "daemon", {}),
        ("unknown-state", "arm", {}),
        ("x", "", {}),
    ],
)
def test_sources_tell_board_bus_and_actuator(code: str, source: str, fields: dict[str, str]) -> None:
    found = fields_of_fault(code, source)
    told = {"HYPERBIT_FAULT": code, "HYPERBIT_SOURCE": source, "MESSAGE_ID": message_id(code)}
    assert found == told | {f"HYPERBIT_{name}": value for name, value in fields.items()}


def test_modes_and_results_have_fields() -> None:
    assert fields_of_mode("fault") == {"MESSAGE_ID": message_id("mode-fault"), "HYPERBIT_MODE": "fault"}
    found = fields_of_result("g", "aborted", -4)
    assert (found["HYPERBIT_GOAL"], found["HYPERBIT_STATUS"], found["HYPERBIT_CODE"]) == ("g", "aborted", "-4")
    assert found["MESSAGE_ID"] == message_id("goal-aborted") != message_id("goal-succeeded")


def test_ids_stay_as_they_are() -> None:
    assert message_id("board-lost") == journal.uuid.uuid5(journal.KINDS, "board-lost").hex
    assert str(journal.KINDS) == "5d1f2f6c-6b0e-4c53-9d0a-7b1f3b7c9a21", "ids in catalogues and scripts depend on it"


def test_only_the_journals_own_stream_is_the_journal(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    first, second = socket.socketpair()
    try:
        about = journal.os.fstat(first.fileno())
        monkeypatch.setenv("JOURNAL_STREAM", f"{about.st_dev}:{about.st_ino}")
        assert is_journal(first.fileno())
        assert not is_journal(second.fileno())
        for text in ("", "x:y", "1", f"{about.st_dev}:", "1:2:3"):
            monkeypatch.setenv("JOURNAL_STREAM", text)
            assert not is_journal(first.fileno())
    finally:
        first.close()
        second.close()
    assert not is_journal(999)
