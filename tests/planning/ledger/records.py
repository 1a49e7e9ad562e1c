"""Records for the ledger of an arm, and what its file says."""

import sqlite3
from pathlib import Path
from typing import Any

from hyperbit.controller.planning.core.events import AcceptanceEntry, Identity, Record, ResultEntry
from hyperbit.controller.planning.ledger_file import read

NAMES = ("1.left", "1.diagonal", "1.right")
SOON = 0.05  # [s] between two transactions
EXECUTOR = 2**62  # the greatest instance
REACHED = ResultEntry(2e9, "succeeded", 0, "reached", 2)


def accepted(program: int, goal: str, instance: int = EXECUTOR, waypoints: int = 1) -> Record:
    return Record(2 * program, Identity(instance, program), AcceptanceEntry(goal, 1.8e9, waypoints), None)


def ended(program: int, result: ResultEntry = REACHED, instance: int = EXECUTOR) -> Record:
    return Record(2 * program + 1, Identity(instance, program), None, result)


def statuses(path: Path) -> list[tuple[str, str | None]]:
    """Returns id and status of each goal, newest first."""
    return [(goal["id"], goal["status"]) for goal in read(path)[1]]


def configuration_text(path: Path) -> tuple[dict[str, int], list[dict[str, Any]]]:
    """Returns the content of the file, which may not exist yet."""
    try:
        return read(path)
    except sqlite3.Error:
        return {}, []
