"""The ledger: switches of every actuator, goals and their results, in SQLite, written beside the control loop."""

import logging
import os
import queue
import sqlite3
import threading
import time
from collections import deque
from collections.abc import Sequence
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

log = logging.getLogger(__name__)

WRITE_EVERY = 0.5  # [s]; a killed daemon loses no more than this
KEPT = 100_000  # goals
SCHEMA = """
CREATE TABLE IF NOT EXISTS switches (actuator TEXT PRIMARY KEY, count INTEGER NOT NULL);
CREATE TABLE IF NOT EXISTS goals (
  number INTEGER PRIMARY KEY, id TEXT NOT NULL, accepted REAL NOT NULL, waypoints INTEGER NOT NULL,
  ended REAL, status TEXT, code INTEGER, message TEXT, switches INTEGER
);
"""


def default_path(arm: str) -> Path:
    """Returns where an arm's ledger is: systemd's StateDirectory, else the user's state folder."""
    if "STATE_DIRECTORY" in os.environ:
        return Path(os.environ["STATE_DIRECTORY"]) / f"{arm}.sqlite"
    base = os.environ.get("XDG_STATE_HOME") or Path.home() / ".local/state"
    return Path(base) / "hyperbit" / f"{arm}.sqlite"


@dataclass(frozen=True, eq=False)
class Pending:
    """What is not yet written: switches of each actuator, shape (A,), and the latest entries on goals."""

    counts: NDArray[np.int64]
    goals: deque[tuple[Any, ...]] = field(default_factory=lambda: deque(maxlen=2 * KEPT))


class Ledger:
    """Counts in memory, adds what is new to the file every half second from a thread of its own.

    A file that cannot be written stops no arm: it is said once, what was counted is kept and written later.

    Args:
        path: of the file, made with its folder if need be.
        actuators: labels, in the order of the state vectors.
    """

    def __init__(self, path: Path, actuators: Sequence[str]) -> None:
        self.path = path
        self.fault: str | None = None
        self._actuators = tuple(actuators)
        self._queue: queue.SimpleQueue[tuple[Any, ...] | None] = queue.SimpleQueue()
        self._thread = threading.Thread(target=self._run, name="ledger", daemon=True)
        self._thread.start()

    def switched(self, actuators: NDArray[np.intp]) -> None:
        """Counts one switch for each of these actuators (indices)."""
        self._queue.put(("switched", actuators))

    def accepted(self, number: int, goal: str, waypoints: int) -> None:
        """Enters an accepted goal; `number` tells it from others of the same id in this run."""
        self._queue.put(("accepted", number, goal, time.time(), waypoints))

    def ended(self, number: int, status: str, code: int, message: str, switches: int) -> None:
        """Enters a goal's result."""
        self._queue.put(("ended", number, time.time(), status, code, message, switches))

    def close(self, timeout: float = 5.0) -> None:
        """Writes what is left."""
        self._queue.put(None)
        self._thread.join(timeout)

    def _run(self) -> None:
        pending = Pending(np.zeros(len(self._actuators), dtype=np.int64))
        rows: dict[int, int] = {}
        last = False
        while not last:
            last = self._collect(pending)
            if not pending.goals and not pending.counts.any():
                continue
            try:
                rows = self._write(pending, rows)
                pending = Pending(np.zeros_like(pending.counts))
                self.fault = None
            except Exception as error:
                if self.fault is None:
                    log.error("ledger %s cannot be written, counting goes on in memory: %s", self.path, error)
                self.fault = f"ledger {self.path} cannot be written: {error}"

    def _collect(self, pending: Pending) -> bool:
        """Moves entries from the queue to `pending` for one interval; returns whether the last has come."""
        until = time.monotonic() + WRITE_EVERY
        while (left := until - time.monotonic()) > 0:
            try:
                entry = self._queue.get(timeout=left)
            except queue.Empty:
                return False
            if entry is None:
                return True
            kind, *values = entry
            if kind == "switched":
                pending.counts[values[0]] += 1
            else:
                pending.goals.append((kind, *values))
        return False

    def _write(self, pending: Pending, rows: dict[int, int]) -> dict[int, int]:
        """Adds all that is pending in one transaction; `rows` are those of this run's goals that have not ended.

        Returns:
            The rows after it.
        """
        rows = dict(rows)
        self.path.parent.mkdir(parents=True, exist_ok=True)
        with closing(sqlite3.connect(self.path, timeout=2.0)) as connection:
            connection.executescript(f"PRAGMA journal_mode=WAL; PRAGMA synchronous=FULL; {SCHEMA}")
            with connection:
                for kind, number, *values in pending.goals:
                    if kind == "accepted":
                        sql = "INSERT INTO goals (id, accepted, waypoints) VALUES (?, ?, ?)"
                        rows[number] = int(connection.execute(sql, values).lastrowid or 0)
                    elif (row := rows.pop(number, None)) is not None:
                        sql = "UPDATE goals SET ended=?, status=?, code=?, message=?, switches=? WHERE number=?"
                        connection.execute(sql, (*values, row))
                connection.execute("DELETE FROM goals WHERE number <= (SELECT max(number) FROM goals) - ?", (KEPT,))
                new = [(self._actuators[k], int(pending.counts[k])) for k in np.flatnonzero(pending.counts)]
                sql = "INSERT INTO switches VALUES (?, ?) ON CONFLICT DO UPDATE SET count = count + excluded.count"
                connection.executemany(sql, new)
        return rows


def counted(path: Path) -> dict[str, int]:
    """Returns the switches of each actuator so far; none where there is no ledger, or none that can be read."""
    try:
        return read(path)[0]
    except sqlite3.Error as error:
        log.info("wear counts as none: %s: %s", path, error)
        return {}


def read(path: Path) -> tuple[dict[str, int], list[dict[str, Any]]]:
    """Returns the switches of each actuator and the goals, newest first.

    Raises:
        sqlite3.Error: the file is missing or no ledger.
    """
    connection = sqlite3.connect(f"file:{path}?mode=ro", uri=True)
    try:
        connection.row_factory = sqlite3.Row
        switches = {row["actuator"]: row["count"] for row in connection.execute("SELECT * FROM switches")}
        goals = [dict(row) for row in connection.execute("SELECT * FROM goals ORDER BY number DESC LIMIT 1000")]
    finally:
        connection.close()
    return switches, goals
