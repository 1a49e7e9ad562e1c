"""The ledger's SQLite file: schema, transactions, damage, and functions to read it."""

import logging
import sqlite3
import time
from collections.abc import Mapping, Sequence
from contextlib import closing, suppress
from pathlib import Path
from types import MappingProxyType
from typing import Any

import msgspec

from hyperbit.controller.host.files import set_aside
from hyperbit.controller.host.folders import state_folder
from hyperbit.controller.planning.core.events import AcceptanceEntry, Identity, Record

log = logging.getLogger(__name__)

MOST_GOALS = 100_000  # rows of the table goals
MOST_OWED = 1_000
SCHEMA = """
CREATE TABLE IF NOT EXISTS switches (actuator TEXT PRIMARY KEY, count INTEGER NOT NULL);
CREATE TABLE IF NOT EXISTS goals (
  number INTEGER PRIMARY KEY, id TEXT NOT NULL, accepted REAL NOT NULL, waypoints INTEGER NOT NULL,
  ended REAL, status TEXT, code INTEGER, message TEXT, switches INTEGER, program INTEGER, instance INTEGER
);
"""
LATER_COLUMNS = ("program", "instance")  # files of earlier versions lack them
# In a unique index NULLs differ: goals of earlier versions have no instance.
INDICES = """
DROP INDEX IF EXISTS unfinished;
CREATE UNIQUE INDEX IF NOT EXISTS identities ON goals (instance, program);
CREATE INDEX IF NOT EXISTS ids ON goals (id);
"""
LOST = """
UPDATE goals SET ended = ?, status = 'lost', message = 'an earlier version recorded no result'
WHERE instance IS NULL AND ended IS NULL
"""
ACCEPTED = """
INSERT INTO goals (id, accepted, waypoints, instance, program) VALUES (?, ?, ?, ?, ?)
ON CONFLICT (instance, program) DO NOTHING
"""
ENDED = """
UPDATE goals SET ended = ?, status = ?, code = ?, message = ?, switches = ?
WHERE instance = ? AND program = ? AND ended IS NULL
"""
OWED = """
SELECT instance, program, id, accepted, waypoints FROM goals
WHERE ended IS NULL AND instance IS NOT NULL ORDER BY number DESC LIMIT ?
"""
COUNTED = "INSERT INTO switches VALUES (?, ?) ON CONFLICT DO UPDATE SET count = max(count, excluded.count)"
FORGOTTEN = "DELETE FROM goals WHERE number <= (SELECT max(number) FROM goals) - ?"


class Damaged(Exception):
    pass


class LedgerFile:
    """One connection, opened by the first transaction. Belongs to one thread. For its arguments see `Ledger`.

    A file that is begun anew gets all counts, and the goals without a result: a result is owed for each of them.
    """

    def __init__(
        self, path: Path, actuators: Sequence[str], running: Mapping[Identity, AcceptanceEntry] = MappingProxyType({})
    ) -> None:
        self._path, self._actuators = path, actuators
        self._connection: sqlite3.Connection | None = None
        self._file = 0, 0  # device and inode
        self._written: dict[str, int] = {}  # counts written by this connection
        self._running = dict(running)  # goals without a result

    def write(self, records: Sequence[Record], counts: Sequence[int]) -> None:
        """Writes records and absolute counts in one transaction, or raises.

        An acceptance that the file already has changes nothing; nor does a second result.
        """
        connection = self._opened()
        present = dict(zip(self._actuators, counts, strict=True))
        new = [(label, count) for label, count in present.items() if count > self._written.get(label, 0)]
        if not records and not new:
            return
        with connection:
            for _, identity, accepted, ended in records:
                if accepted is not None:
                    connection.execute(ACCEPTED, (plain(accepted.goal), *accepted[1:], *identity))
                if ended is not None:
                    connection.execute(ENDED, (*ended._replace(message=plain(ended.message)), *identity))
            connection.execute(FORGOTTEN, (MOST_GOALS,))
            connection.executemany(COUNTED, new)
        self._written |= dict(new)
        for _, identity, accepted, ended in records:
            if ended is not None:
                self._running.pop(identity, None)
            elif accepted is not None:
                self._running[identity] = accepted
        while len(self._running) > MOST_OWED:
            del self._running[next(iter(self._running))]

    def close(self) -> None:
        if self._connection is not None:
            self._connection.close()
            self._connection = None

    def set_aside(self, why: Exception) -> str | None:
        """Renames a damaged file; returns a sentence for users, or None if that is impossible."""
        then = "a new one was begun, with all counts, and with the goals that have no result yet"
        return set_aside(self._path, why, then, "-wal", "-shm")

    def is_gone(self) -> bool:
        """Returns whether somebody has deleted, moved or replaced the open file."""
        return self._connection is not None and identified(self._path) != self._file

    def _opened(self) -> sqlite3.Connection:
        """Returns the connection; begins a new file if another process moved or deleted the old one."""
        if self.is_gone():
            log.warning("%s was deleted or moved: a new one is begun, with all counts", self._path)
            self.close()
        if self._connection is not None:
            return self._connection
        self._path.parent.mkdir(parents=True, exist_ok=True)
        connection = sqlite3.connect(self._path, timeout=2.0, check_same_thread=False)
        try:
            connection.executescript(f"PRAGMA journal_mode=WAL; PRAGMA synchronous=NORMAL; {SCHEMA}")
            present = [row[1] for row in connection.execute("PRAGMA table_info(goals)")]
            for column in LATER_COLUMNS:
                if column not in present:
                    connection.execute(f"ALTER TABLE goals ADD COLUMN {column} INTEGER")
            connection.executescript(INDICES)
            with connection:
                connection.execute(LOST, (time.time(),))
                for identity, accepted in self._running.items():
                    connection.execute(ACCEPTED, (plain(accepted.goal), *accepted[1:], *identity))
            (sound,) = connection.execute("PRAGMA quick_check(1)").fetchone()
            if sound != "ok":
                raise Damaged(sound)
        except BaseException:
            connection.close()
            raise
        self._connection, self._file, self._written = connection, identified(self._path), {}
        return connection


def identified(path: Path) -> tuple[int, int]:
    """Returns device and inode of a file; zeros if it is gone."""
    try:
        found = path.stat()
    except OSError:
        return 0, 0
    return found.st_dev, found.st_ino


def damaged(error: Exception) -> bool:
    code = getattr(error, "sqlite_errorcode", 0) & 0xFF
    return isinstance(error, Damaged) or code in (sqlite3.SQLITE_CORRUPT, sqlite3.SQLITE_NOTADB)


def default_path(arm: str, *, simulated: bool = False) -> Path:
    return state_folder(simulated=simulated) / f"{arm}.sqlite"


def counted(path: Path) -> dict[str, int]:
    """Returns the number of switches of each actuator; empty if the ledger is missing or unreadable."""
    if not path.exists():  # the first start
        return {}
    try:
        found = read(path)[0]
    except (sqlite3.Error, OSError) as error:
        log.info("no counts in the ledger %s: %s", path, error)
        return {}
    return {actuator: count for actuator, count in found.items() if type(count) is int}


def owed(path: Path) -> dict[Identity, AcceptanceEntry]:
    """Returns the newest thousand goals without a result, the oldest first; of a damaged ledger those that can be read.

    Goals of earlier versions have no identity: no result can be found for them.
    """
    found: dict[Identity, AcceptanceEntry] = {}
    try:
        with closing(readable(path)) as connection:
            for row in connection.execute(OWED, (MOST_OWED,)):
                with suppress(msgspec.ValidationError):  # SQLite stores values of any type in any column
                    found[msgspec.convert(row[:2], Identity)] = msgspec.convert(row[2:], AcceptanceEntry)
    except sqlite3.Error as error:  # also a missing file, and one of an earlier version
        log.debug("no more goals in the ledger %s: %s", path, error)
    return dict(reversed(found.items()))


def read(path: Path) -> tuple[dict[str, int], list[dict[str, Any]]]:
    """Returns the switches of each actuator, and the latest thousand goals, newest first; may raise sqlite3.Error."""
    with closing(readable(path)) as connection:
        switches = {row["actuator"]: row["count"] for row in connection.execute("SELECT * FROM switches")}
        goals = [dict(row) for row in connection.execute("SELECT * FROM goals ORDER BY number DESC LIMIT 1000")]
    return switches, goals


def find(path: Path, goal: str) -> dict[str, Any] | None:
    """Returns the row of the newest goal with this id, without `ended` if it runs; may raise sqlite3.Error."""
    with closing(readable(path)) as connection:
        row = connection.execute("SELECT * FROM goals WHERE id = ? ORDER BY number DESC", (plain(goal),)).fetchone()
    return None if row is None else dict(row)


def readable(path: Path) -> sqlite3.Connection:
    connection = sqlite3.connect(f"{path.absolute().as_uri()}?mode=ro", uri=True)
    connection.row_factory = sqlite3.Row
    return connection


def plain(text: str) -> str:
    """Returns a text that SQLite and JSON can store: lone surrogates become escapes."""
    return text.encode(errors="backslashreplace").decode()
