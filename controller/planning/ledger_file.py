"""The ledger's SQLite file: schema, transactions, damage, and functions to read it."""

import logging
import os
import sqlite3
import time
from collections.abc import Sequence
from contextlib import closing
from pathlib import Path
from typing import Any

from hyperbit.controller.host.folders import state_folder
from hyperbit.controller.host.keeper import set_aside
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
    """One connection, opened by the first transaction. Belongs to one thread. For its arguments see `Ledger`."""

    def __init__(self, path: Path, actuators: Sequence[str]) -> None:
        self._path, self._actuators = path, actuators
        self._connection: sqlite3.Connection | None = None
        self._inode = 0
        self._written: dict[str, int] = {}  # counts written by this connection

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

    def close(self) -> None:
        if self._connection is not None:
            self._connection.close()
            self._connection = None

    def set_aside(self) -> str | None:
        try:
            return set_aside(self._path, "-wal", "-shm")
        except OSError:
            return None

    def _opened(self) -> sqlite3.Connection:
        """Returns the connection; opens it again if another process moved or deleted the file."""
        if self._connection is not None and self._path.exists() and self._path.stat().st_ino == self._inode:
            return self._connection
        self.close()
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
            (sound,) = connection.execute("PRAGMA quick_check(1)").fetchone()
            if sound != "ok":
                raise Damaged(sound)
        except BaseException:
            connection.close()
            raise
        self._connection, self._inode, self._written = connection, os.stat(self._path).st_ino, {}
        return connection


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
        return read(path)[0]
    except (sqlite3.Error, OSError) as error:
        log.info("no counts in the ledger %s: %s", path, error)
        return {}


def owed(path: Path) -> dict[Identity, AcceptanceEntry]:
    """Returns the newest thousand goals without a result, the oldest first; none if the ledger is unreadable.

    Goals of earlier versions have no identity: no result can be found for them.
    """
    try:
        with closing(readable(path)) as connection:
            rows = connection.execute(OWED, (MOST_OWED,)).fetchall()
    except sqlite3.Error as error:  # also a missing file, and one of an earlier version
        log.debug("no goals in the ledger %s: %s", path, error)
        return {}
    return {Identity(*row[:2]): AcceptanceEntry(*row[2:]) for row in reversed(rows)}


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
