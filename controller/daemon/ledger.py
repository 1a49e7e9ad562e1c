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
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from controller.daemon.tally import Tally
from controller.daemon.tally import default_path as default_tally_path
from drivers.faults import Fault

log = logging.getLogger(__name__)

WRITE_EVERY = 0.5  # [s]; a computer that loses its power loses no more than this
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


class Ledger:
    """Counts in memory, adds what is new to the file every half second from a thread of its own.

    A file that cannot be written stops no arm: it is said once, what was counted is kept and written later. A damaged
    file is moved aside, and a new one begun with the counts.

    Attributes:
        fault: why the file cannot be written now, None while it can.
        damage: what became of a damaged file, None if it was none.

    Args:
        path: of the file, made with its folder if need be.
        actuators: labels, in the order of the state vectors.
    """

    def __init__(self, path: Path, actuators: Sequence[str]) -> None:
        self.path = path
        self.fault: str | None = None
        self.damage: str | None = None
        self._actuators = tuple(actuators)
        known = counted(path)
        self._written = np.array([known.get(label, 0) for label in actuators], dtype=np.int64)
        self._tally = Tally(default_tally_path(path), actuators, self._written)
        self._totals = self._tally.counts.copy()
        self._goals: deque[tuple[Any, ...]] = deque(maxlen=2 * KEPT)  # entries that are not yet written
        self._rows: dict[int, int] = {}  # of this run's goals that have not ended
        self._queue: queue.SimpleQueue[tuple[Any, ...] | None] = queue.SimpleQueue()
        self._thread = threading.Thread(target=self._run, name="ledger", daemon=True)
        self._thread.start()

    def intend(self, outputs: NDArray[np.uint8], states: NDArray[np.uint8]) -> None:
        """Notes that boards with these outputs (A,) are to be switched to these states (A,), before they are."""
        self._tally.intend(outputs, states)

    def resolve(self, outputs: NDArray[np.uint8]) -> NDArray[np.intp]:
        """Counts what of the intended has come about, as the boards' outputs (A,) tell; returns those actuators."""
        switched = self._tally.resolve(outputs)
        if len(switched):
            self._queue.put(("switched", self._tally.counts.copy()))
        return switched

    def accepted(self, number: int, goal: str, waypoints: int) -> None:
        """Enters an accepted goal; `number` tells it from others of the same id in this run."""
        self._queue.put(("accepted", number, goal, time.time(), waypoints))

    def ended(self, number: int, status: str, code: int, message: str, switches: int) -> None:
        """Enters a goal's result."""
        self._queue.put(("ended", number, time.time(), status, code, message, switches))

    def faults(self) -> tuple[Fault, ...]:
        """Returns what is wrong with the file, which stops no arm."""
        told = (("ledger-unwritten", self.fault), ("ledger-damaged", self.damage))
        return tuple(Fault(code, "ledger", message) for code, message in told if message is not None)

    def close(self, timeout: float = 5.0) -> None:
        """Writes what is left."""
        self._queue.put(None)
        self._thread.join(timeout)
        self._tally.close()

    def _run(self) -> None:
        last = False
        while not last:
            last = self._collect()
            if not self._goals and np.array_equal(self._totals, self._written):
                continue
            try:
                self._rows = self._write()
                self._written = self._totals.copy()
                self._goals.clear()
                self.fault = None
            except Exception as error:
                if not self._set_aside(error):
                    if self.fault is None:
                        log.error("ledger %s cannot be written, counting goes on in memory: %s", self.path, error)
                    self.fault = f"ledger {self.path} cannot be written: {error}"

    def _collect(self) -> bool:
        """Takes in what comes for one interval; returns whether the last has come."""
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
                self._totals = values[0]
            else:
                self._goals.append((kind, *values))
        return False

    def _write(self) -> dict[int, int]:
        """Adds all that is not yet written in one transaction.

        Returns:
            The rows of goals that have not ended, after it.
        """
        rows = dict(self._rows)
        self.path.parent.mkdir(parents=True, exist_ok=True)
        with closing(sqlite3.connect(self.path, timeout=2.0)) as connection:
            connection.executescript(f"PRAGMA journal_mode=WAL; PRAGMA synchronous=FULL; {SCHEMA}")
            with connection:
                for kind, number, *values in self._goals:
                    if kind == "accepted":
                        sql = "INSERT INTO goals (id, accepted, waypoints) VALUES (?, ?, ?)"
                        rows[number] = int(connection.execute(sql, values).lastrowid or 0)
                    elif (row := rows.pop(number, None)) is not None:
                        sql = "UPDATE goals SET ended=?, status=?, code=?, message=?, switches=? WHERE number=?"
                        connection.execute(sql, (*values, row))
                connection.execute("DELETE FROM goals WHERE number <= (SELECT max(number) FROM goals) - ?", (KEPT,))
                new = self._totals - self._written
                sql = "INSERT INTO switches VALUES (?, ?) ON CONFLICT DO UPDATE SET count = count + excluded.count"
                connection.executemany(sql, [(self._actuators[k], int(new[k])) for k in np.flatnonzero(new)])
        return rows

    def _set_aside(self, error: Exception) -> bool:
        """Moves the file away if the error says that it is damaged; all counts are then written to a new one."""
        if getattr(error, "sqlite_errorcode", 0) & 0xFF not in (sqlite3.SQLITE_CORRUPT, sqlite3.SQLITE_NOTADB):
            return False
        aside = self.path.with_name(f"{self.path.name}.damaged-{time.time():.0f}")
        try:
            for suffix in ("", "-wal", "-shm"):
                if (part := Path(f"{self.path}{suffix}")).exists():
                    part.rename(f"{aside}{suffix}")
        except OSError:
            return False
        self.damage = f"ledger {self.path} was damaged ({error}): it is {aside.name} now, and a new one was begun"
        log.error("%s", self.damage)
        self._written, self._rows = np.zeros_like(self._totals), {}
        return True


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
