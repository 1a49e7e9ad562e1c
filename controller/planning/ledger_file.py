"""The ledger's SQLite file: schema, transactions, damage, and functions to read it."""

import logging
import os
import sqlite3
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

log = logging.getLogger(__name__)

MOST_GOALS = 100_000  # rows of the table goals
SCHEMA = """
CREATE TABLE IF NOT EXISTS switches (actuator TEXT PRIMARY KEY, count INTEGER NOT NULL);
CREATE TABLE IF NOT EXISTS goals (
  number INTEGER PRIMARY KEY, id TEXT NOT NULL, accepted REAL NOT NULL, waypoints INTEGER NOT NULL,
  ended REAL, status TEXT, code INTEGER, message TEXT, switches INTEGER, program INTEGER
);
"""
UNFINISHED = "CREATE INDEX IF NOT EXISTS unfinished ON goals (program) WHERE ended IS NULL"
ACCEPTED = "INSERT INTO goals (id, accepted, waypoints, program) VALUES (?, ?, ?, ?)"
ENDED = """
UPDATE goals SET ended = ?, status = ?, code = ?, message = ?, switches = ?
WHERE number = (SELECT max(number) FROM goals WHERE program = ? AND ended IS NULL)
"""
ADOPTED = """
INSERT INTO goals (id, accepted, waypoints, program, ended, status, code, message, switches)
SELECT ?, ?, ?, ?, ?, ?, ?, ?, ?
WHERE NOT EXISTS (SELECT 1 FROM goals WHERE program = ? AND id = ? AND ended >= ?)
"""
COUNTED = "INSERT INTO switches VALUES (?, ?) ON CONFLICT DO UPDATE SET count = max(count, excluded.count)"
FORGOTTEN = "DELETE FROM goals WHERE number <= (SELECT max(number) FROM goals) - ?"


class Entry(NamedTuple):
    """A goal that was accepted, or that ended.

    Attributes:
        number: of its program.
        accepted: id, UNIX seconds, waypoints.
        ended: UNIX seconds, status, code, message, switches. With `accepted` too, the goal may not be in the file yet.
    """

    number: int
    accepted: tuple[str, float, int] | None = None
    ended: tuple[float, str, int, str, int] | None = None


class LedgerFile:
    """One connection, opened by the first transaction. Belongs to one thread.

    Args:
        path: of the file.
        actuators: labels, in the order of the counts.
    """

    def __init__(self, path: Path, actuators: Sequence[str]) -> None:
        self._path, self._actuators = path, actuators
        self._connection: sqlite3.Connection | None = None
        self._inode = 0
        self._written: dict[str, int] = {}  # counts written by this connection

    def write(self, goals: Sequence[Entry], counts: Sequence[int]) -> None:
        """Writes entries and absolute counts in one transaction.

        Raises:
            Exception: from SQLite or the file system; nothing was written.
        """
        connection = self._opened()
        new = [
            (label, count)
            for label, count in zip(self._actuators, counts, strict=True)
            if count > self._written.get(label, 0)
        ]
        if not goals and not new:
            return
        with connection:
            for entry in goals:
                if entry.accepted is not None and entry.ended is None:
                    connection.execute(ACCEPTED, (*entry.accepted, entry.number))
                if entry.ended is not None:
                    found = connection.execute(ENDED, (*entry.ended, entry.number)).rowcount
                    if not found and entry.accepted is not None:
                        goal, accepted, _ = entry.accepted
                        row = (*entry.accepted, entry.number, *entry.ended)
                        connection.execute(ADOPTED, (*row, entry.number, goal, accepted))
            connection.execute(FORGOTTEN, (MOST_GOALS,))
            connection.executemany(COUNTED, new)
        self._written |= dict(new)

    def close(self) -> None:
        """Closes the connection."""
        if self._connection is not None:
            try:
                self._connection.close()
            except sqlite3.Error as error:
                log.debug("ledger %s: %s", self._path, error)
            self._connection = None

    def set_aside(self) -> str | None:
        """Renames a damaged file; returns its new name, or None if that fails."""
        renamed = self._path.with_name(f"{self._path.name}.damaged-{time.time():.0f}")
        try:
            for suffix in ("", "-wal", "-shm"):
                if (part := Path(f"{self._path}{suffix}")).exists():
                    part.rename(f"{renamed}{suffix}")
        except OSError:
            return None
        return renamed.name

    def _opened(self) -> sqlite3.Connection:
        if self._connection is not None and not self._replaced():
            return self._connection
        self.close()
        self._path.parent.mkdir(parents=True, exist_ok=True)
        connection = sqlite3.connect(self._path, timeout=2.0, check_same_thread=False)
        try:
            connection.executescript(f"PRAGMA journal_mode=WAL; PRAGMA synchronous=FULL; {SCHEMA}")
            columns = [row[1] for row in connection.execute("PRAGMA table_info(goals)")]
            if "program" not in columns:  # the file is of an earlier version
                connection.execute("ALTER TABLE goals ADD COLUMN program INTEGER")
            connection.execute(UNFINISHED)
            (sound,) = connection.execute("PRAGMA quick_check(1)").fetchone()
            if sound != "ok":
                raise Damaged(sound)
        except BaseException:
            connection.close()
            raise
        self._connection, self._inode, self._written = connection, os.stat(self._path).st_ino, {}
        return connection

    def _replaced(self) -> bool:
        """Returns whether another process moved or deleted the file."""
        try:
            return os.stat(self._path).st_ino != self._inode
        except OSError:
            return True


class Damaged(Exception):
    """SQLite's check found the file damaged."""


def damaged(error: Exception) -> bool:
    """Returns whether an error means that the file is damaged."""
    code = getattr(error, "sqlite_errorcode", 0) & 0xFF
    return isinstance(error, Damaged) or code in (sqlite3.SQLITE_CORRUPT, sqlite3.SQLITE_NOTADB)


def default_path(arm: str) -> Path:
    """Returns the path of an arm's ledger: in systemd's StateDirectory, otherwise in the user's state folder."""
    if "STATE_DIRECTORY" in os.environ:
        return Path(os.environ["STATE_DIRECTORY"]) / f"{arm}.sqlite"
    base = os.environ.get("XDG_STATE_HOME") or Path.home() / ".local/state"
    return Path(base) / "hyperbit" / f"{arm}.sqlite"


def counted(path: Path) -> dict[str, int]:
    """Returns the number of switches of each actuator so far; empty if the ledger is missing or cannot be read."""
    if not path.exists():  # the first start
        return {}
    try:
        return read(path)[0]
    except (sqlite3.Error, OSError) as error:
        log.info("no counts in the ledger %s: %s", path, error)
        return {}


def read(path: Path) -> tuple[dict[str, int], list[dict[str, Any]]]:
    """Returns the number of switches of each actuator, and the latest thousand goals, newest first.

    Raises:
        sqlite3.Error: the file is missing, or is no ledger.
    """
    connection = sqlite3.connect(f"file:{path}?mode=ro", uri=True)
    try:
        connection.row_factory = sqlite3.Row
        switches = {row["actuator"]: row["count"] for row in connection.execute("SELECT * FROM switches")}
        goals = [dict(row) for row in connection.execute("SELECT * FROM goals ORDER BY number DESC LIMIT 1000")]
    finally:
        connection.close()
    return switches, goals
