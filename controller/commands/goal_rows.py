"""CSV files of goals, which `plan` and `send` read: position, and orientation if given, in each row."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TypeVar

from hyperbit.controller.armfile.csv_files import csv_rows
from hyperbit.controller.armfile.strict import InputFaults
from hyperbit.controller.commands.common import parse_goal

Orientation = float | list[float] | None  # an angle [rad], a unit quaternion x, y, z, w, or any orientation
T = TypeVar("T")


def goal_rows(
    path: Path, further: str, read: Callable[[str, str], T], dimension: int | None = None
) -> Iterator[tuple[list[float], Orientation, T | None]]:
    """Yields the goals of a CSV file as they are read. The faults of all rows come at the end, each with its line.

    Args:
        path: of the file.
        further: a column that may stand there beside position and orientation.
        read: reads a field of this column; its second argument is the line, for messages.
        dimension: of the arm, 2 or 3; None: 3 if there is a column z.

    Yields:
        Position, shape (dimension,), orientation, and what was read; None if the field is empty.
    """
    rows, faults, count = csv_rows(path), list[str](), 0
    there = next(rows).fields
    dimension = dimension or (3 if "z" in there else 2)
    columns = ["x", "y", "z"][:dimension]
    turns = ["th"] if dimension == 2 else ["qx", "qy", "qz", "qw"]
    if set(turns) <= set(there):
        columns += turns
    if not set(columns) <= set(there) <= {*columns, further}:
        needed = f"columns {','.join(columns)} are needed, {','.join(turns)} and {further} are optional"
        raise InputFaults(path, [f"{needed}; got {there}"])
    for row in rows:
        where, record = f"line {row.line}", dict(zip(there, row.fields, strict=True))
        fields = [record[name] for name in columns]
        while fields and not fields[-1].strip():
            fields.pop()
        try:
            wanted = parse_goal(fields, dimension, where)
            more = read(record[further], where) if record.get(further) else None
        except InputFaults as error:
            faults += [f"{where}: {fault}" for fault in error.faults]
        else:
            yield *wanted, more
            count += 1
    if faults or not count:
        raise InputFaults(path, faults or ["no goals"])
