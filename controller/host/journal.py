"""Log lines for systemd's journal, with fields: `journalctl -u 'hyperbit*' HYPERBIT_BOARD=3`, and MESSAGE_IDs for -x.

Each kind of message has a permanent id, derived from its name; deploy/hyperbit.catalog explains the kinds. In the
journal's native protocol a message is a datagram of NAME=value lines; a value with a line break follows its length.
"""

import logging
import os
import re
import socket
import stat
import sys
import uuid
from collections.abc import Mapping
from functools import cache

from hyperbit.controller.host.output import Backlog, never_wait

SOCKET = "/run/systemd/journal/socket"
KINDS = uuid.UUID("5d1f2f6c-6b0e-4c53-9d0a-7b1f3b7c9a21")  # the name space of the ids
MOST_TEXT = 60_000  # bytes of a field
PRIORITIES = ((logging.CRITICAL, 2), (logging.ERROR, 3), (logging.WARNING, 4), (logging.INFO, 6))  # syslog's
BOARD = re.compile(r"(?P<bus>[\w.-]+)/(?P<board>\d+)\b")
ACTUATOR = re.compile(r"(?P<actuator>\d+\.[\w-]+)(?: |\Z)")
BUS = re.compile(r"[\w.-]+\Z")

Fields = Mapping[str, str]


@cache
def message_id(kind: str) -> str:
    """Returns the MESSAGE_ID of a kind of message, such as a fault's code: 32 hexadecimal digits."""
    return uuid.uuid5(KINDS, kind).hex


def fields_of_fault(code: str, source: str) -> dict[str, str]:
    """Returns the fields of a fault or warning: code, source, and the board, bus or actuator in the source."""
    fields = {"MESSAGE_ID": message_id(code), "HYPERBIT_FAULT": code, "HYPERBIT_SOURCE": source}
    if (actuator := ACTUATOR.match(source)) is not None:
        fields["HYPERBIT_ACTUATOR"] = actuator["actuator"]
    if (board := BOARD.search(source)) is not None:
        fields |= {"HYPERBIT_BUS": board["bus"], "HYPERBIT_BOARD": board["board"]}
    elif actuator is None and BUS.match(source) and code.startswith(("bus-", "foreign-")):
        fields["HYPERBIT_BUS"] = source
    return fields


def fields_of_mode(mode: str) -> dict[str, str]:
    return {"MESSAGE_ID": message_id(f"mode-{mode}"), "HYPERBIT_MODE": mode}


def fields_of_result(goal: str, status: str, code: int) -> dict[str, str]:
    fields = {"HYPERBIT_GOAL": goal, "HYPERBIT_STATUS": status, "HYPERBIT_CODE": str(code)}
    return {"MESSAGE_ID": message_id(f"goal-{status}"), **fields}


def fields_of_refusal(goal: str, reason: str, code: int) -> dict[str, str]:
    fields = {"HYPERBIT_GOAL": goal, "HYPERBIT_REASON": reason, "HYPERBIT_CODE": str(code)}
    return {"MESSAGE_ID": message_id(f"refused-{reason}"), **fields}


class JournalHandler(logging.Handler):
    """Sends each record to the journal without waiting; unsent datagrams go before the next record.

    If the journal's socket is missing or refuses, the records go to the handler `other`. `common`: fields of every
    record.
    """

    def __init__(self, other: logging.Handler, common: Fields, path: str = SOCKET) -> None:
        super().__init__()
        self._other = other
        self._common = {"SYSLOG_IDENTIFIER": "hyperbit", **common}
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_NONBLOCK | socket.SOCK_CLOEXEC)
        self._backlog = Backlog(lambda data: self._socket.sendto(data, path), self._dropped)

    def emit(self, record: logging.LogRecord) -> None:
        try:
            data = datagram({**self._common, **fields_of(record)})
        except Exception:  # an error in a log call must not stop the arm
            self._other.handle(record)
            return
        self._backlog.put(data)
        if not self._backlog.flush():  # the journal is gone
            self._other.handle(record)

    def flush(self) -> None:
        self._backlog.flush()

    def close(self) -> None:
        self._backlog.finish()
        self._socket.close()
        self._other.close()
        super().close()

    def _dropped(self, count: int) -> bytes:
        text = f"{count} lines were dropped: the journal did not read them"
        return datagram({**self._common, "MESSAGE": text, "PRIORITY": "4"})


def start_logging(common: Fields) -> None:
    """Sends log lines to the journal if the standard error is connected to it, otherwise to the standard error.

    From now on nothing that this process prints waits for its reader. `common`: fields of each line in the journal.
    """
    never_wait()
    handler: logging.Handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(logging.Formatter("%(levelname)s %(name)s: %(message)s"))
    try:
        journal = is_journal(sys.stderr.fileno())
    except OSError:  # the stream has no file descriptor
        journal = False
    if journal:
        handler = JournalHandler(handler, common)
    logging.basicConfig(level=logging.INFO, handlers=[handler])


def is_journal(output: int) -> bool:
    """Returns whether a file descriptor is the stream to the journal that systemd opened for this process."""
    device, _, inode = os.environ.get("JOURNAL_STREAM", "").partition(":")
    if not device.isdecimal() or not inode.isdecimal():
        return False
    try:
        about = os.fstat(output)
    except OSError:
        return False
    return stat.S_ISSOCK(about.st_mode) and (about.st_dev, about.st_ino) == (int(device), int(inode))


def fields_of(record: logging.LogRecord) -> dict[str, str]:
    text = record.getMessage()
    if record.exc_info:
        text += "\n" + logging.Formatter().formatException(record.exc_info)
    return {
        "MESSAGE": text,
        "PRIORITY": str(next((number for level, number in PRIORITIES if record.levelno >= level), 7)),
        "LOGGER": record.name,
        "CODE_FILE": record.pathname,
        "CODE_LINE": str(record.lineno),
        "CODE_FUNC": record.funcName or "",
        **getattr(record, "journal", {}),
    }


def datagram(fields: Fields) -> bytes:
    data = bytearray()
    for name, value in fields.items():
        encoded = value.encode(errors="backslashreplace")[:MOST_TEXT]
        if b"\n" in encoded:
            data += name.encode() + b"\n" + len(encoded).to_bytes(8, "little") + encoded + b"\n"
        else:
            data += name.encode() + b"=" + encoded + b"\n"
    return bytes(data)
