"""The ledger: switches of every actuator, goals and their results, in SQLite, written beside the control loop."""

import logging
import os
import queue
import sqlite3
import threading
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

log = logging.getLogger(__name__)

WRITE_EVERY = 0.5  # [s]; a killed daemon loses no more than this
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
        pending: list[tuple[Any, ...]] = []
        rows: dict[int, int] = {}
        closing = False
        while not closing:
            closing = self._collect(pending)
            if not pending:
                continue
            try:
                self._write(pending, rows)
                pending.clear()
                self.fault = None
            except (sqlite3.Error, OSError) as error:
                if self.fault is None:
                    log.error("ledger %s cannot be written, counting goes on in memory: %s", self.path, error)
                self.fault = f"ledger {self.path} cannot be written: {error}"

    def _collect(self, pending: list[tuple[Any, ...]]) -> bool:
        """Moves entries from the queue to `pending` for one interval; returns whether the last has come."""
        until = time.monotonic() + WRITE_EVERY
        while (left := until - time.monotonic()) > 0:
            try:
                entry = self._queue.get(timeout=left)
            except queue.Empty:
                return False
            if entry is None:
                return True
            pending.append(entry)
        return False

    def _write(self, pending: list[tuple[Any, ...]], rows: dict[int, int]) -> None:
        """Adds all pending entries in one transaction; `rows` maps this run's goals to their rows, once it is done."""
        counts = np.zeros(len(self._actuators), dtype=np.int64)
        added = dict(rows)
        self.path.parent.mkdir(parents=True, exist_ok=True)
        connection = sqlite3.connect(self.path, timeout=2.0)
        try:
            connection.executescript(f"PRAGMA journal_mode=WAL; PRAGMA synchronous=FULL; {SCHEMA}")
            with connection:
                for kind, *entry in pending:
                    if kind == "switched":
                        counts[entry[0]] += 1
                    elif kind == "accepted":
                        number, *values = entry
                        sql = "INSERT INTO goals (id, accepted, waypoints) VALUES (?, ?, ?)"
                        added[number] = int(connection.execute(sql, values).lastrowid or 0)
                    else:
                        number, *values = entry
                        sql = "UPDATE goals SET ended=?, status=?, code=?, message=?, switches=? WHERE number=?"
                        connection.execute(sql, (*values, added[number]))
                new = [(self._actuators[k], int(counts[k])) for k in np.flatnonzero(counts)]
                sql = "INSERT INTO switches VALUES (?, ?) ON CONFLICT DO UPDATE SET count = count + excluded.count"
                connection.executemany(sql, new)
        finally:
            connection.close()
        rows.clear()
        rows.update(added)


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
