"""CSV files of goals, which `plan` and `send` read: position, and orientation if given, in each row."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from hyperbit.controller.armfile.csv_files import csv_rows, record_of
from hyperbit.controller.armfile.strict import InputFaults
from hyperbit.controller.commands.common import parse_goal

Orientation = float | list[float] | None


class GoalRow(NamedTuple):
    """One goal of a file.

    Attributes:
        where: its line, for messages.
        position: shape (dimension,).
        orientation: an angle [rad] or a unit quaternion x, y, z, w; None: any orientation.
        more: texts of the further columns; "" where a field is empty.
    """

    where: str
    position: list[float]
    orientation: Orientation
    more: dict[str, str]


def read_goal_rows(path: Path, further: tuple[str, ...], dimension: int | None = None) -> list[GoalRow]:
    """Reads the goals of a CSV file.

    Args:
        path: of the file.
        further: columns that may stand there beside position and orientation.
        dimension: of the arm, 2 or 3; None: 3 if there is a column z.

    Raises:
        InputFaults: the file is missing or wrong; each fault names its line.
    """
    faults = list[str]()
    goals = list(goal_rows(path, further, dimension, faults))
    if faults or not goals:
        raise InputFaults(path, faults or ["no goals"])
    return goals


def goal_rows(path: Path, further: tuple[str, ...], dimension: int | None, faults: list[str]) -> Iterator[GoalRow]:
    """Yields the goals of a CSV file as they are read; appends a fault for each row that is wrong.

    Raises:
        InputFaults: the file cannot be read, or its columns are wrong.
    """
    rows = csv_rows(path)
    there = next(rows).fields
    dimension = dimension or (3 if "z" in there else 2)
    columns = ["x", "y", "z"][:dimension]
    turns = ["th"] if dimension == 2 else ["qx", "qy", "qz", "qw"]
    if set(turns) <= set(there):
        columns += turns
    if not set(columns) <= set(there) <= {*columns, *further}:
        needed = f"columns {','.join(columns)} are needed, {','.join(turns)} and {','.join(further)} are optional"
        raise InputFaults(path, [f"{needed}; got {there}"])
    for row in rows:
        if not row.fields:
            continue
        where, record = f"line {row.line}", record_of(there, row)
        try:
            wanted = parse_goal(",".join(record[name] for name in columns).rstrip(","), dimension, where)
            yield GoalRow(where, *wanted, {name: record.get(name, "") for name in further})
        except InputFaults as error:
            faults += [f"{where}: {fault}" for fault in error.faults]
