"""Files of goals for all who read them: CSV with a waypoint in each row, JSON, or YAML with the fields of a goal."""

from __future__ import annotations

import io
import math
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from hyperbit.controller.armfile.choices import LARGEST, LARGEST_ANGLE, number
from hyperbit.controller.armfile.csv_files import CsvRow, csv_rows, rows_of
from hyperbit.controller.armfile.documents import MOST_YAML, parse_payload, read_text
from hyperbit.controller.armfile.strict import UNIT, InputFaults

Orientation = float | list[float] | None  # an angle [rad], a unit quaternion x, y, z, w, or any orientation

BOM = "\ufeff"  # spreadsheets write a byte order mark
CSV = ".csv"  # ending of a file with a waypoint in each row
STUDY = "column previous: it is for studies, `plan --goals`; a goal that is sent starts where the arm is"


class GoalRow(NamedTuple):
    """A waypoint of a CSV file; `where` is its line, for messages."""

    where: str
    position: list[float]
    orientation: Orientation
    t: float | None  # time after the first waypoint [s]
    previous: str  # configuration from which its search starts; "": the one before

    @property
    def waypoint(self) -> dict[str, Any]:
        """The waypoint of a goal's payload."""
        more = {"orientation": self.orientation, "t": self.t}
        return {"position": self.position, **{name: value for name, value in more.items() if value is not None}}


def read_goal(path: Path) -> dict[str, Any]:
    """Returns the payload of a goal's file.

    Raises:
        InputFaults: the file cannot be read; each fault names its line.
    """
    if path.suffix.lower() == CSV:
        return payload_of(goal_rows(path), path)
    return parse_payload(read_text(path), path, "goal", "waypoints")


def parse_goal_file(text: str, path: Path, most_yaml: int = MOST_YAML) -> dict[str, Any]:
    """Returns the payload in the text of a file, as `read_goal` does; `most_yaml`: most characters of YAML."""
    if path.suffix.lower() == CSV:
        return payload_of(waypoints_of(path, rows_of(path, io.StringIO(text.removeprefix(BOM), newline=""))), path)
    return parse_payload(text, path, "goal", "waypoints", most_yaml)


def payload_of(rows: Iterator[GoalRow], path: Path) -> dict[str, Any]:
    every = list(rows)
    if any(row.previous for row in every):
        raise InputFaults(path, [STUDY])
    if any(row.t is not None for row in every[1:]) and (late := [row.where for row in every[1:] if row.t is None]):
        raise InputFaults(path, [f"{late[0]}: no t: give a time [s] to each row, or to none"])
    return {"waypoints": [row.waypoint for row in every]}


def goal_rows(path: Path, dimension: int | None = None) -> Iterator[GoalRow]:
    """Yields the waypoints of a CSV file as they are read. The faults of all rows come at the end, each with its line.

    `dimension` is that of the arm, 2 or 3; None: 3 if there is a column z.

    Raises:
        InputFaults: the file cannot be read, has other columns, no row, or a row is no waypoint.
    """
    return waypoints_of(path, csv_rows(path), dimension)


def waypoints_of(path: Path, rows: Iterator[CsvRow], dimension: int | None = None) -> Iterator[GoalRow]:
    """Yields the waypoints of rows of CSV, the names of the columns first; see `goal_rows`."""
    faults, count = list[str](), 0
    there = next(rows).fields
    dimension = dimension or (3 if "z" in there else 2)
    columns = ["x", "y", "z"][:dimension]
    turns = ["th"] if dimension == 2 else ["qx", "qy", "qz", "qw"]
    if set(turns) <= set(there):
        columns += turns
    if not set(columns) <= set(there) <= {*columns, "t", "previous"}:
        needed = f"columns {','.join(columns)} are needed, {','.join(turns)}, t and previous are optional"
        raise InputFaults(path, [f"{needed}; got {there}"])
    for row in rows:
        where, record = f"line {row.line}", dict(zip(there, row.fields, strict=True))
        fields = [record[name] for name in columns]
        while fields and not fields[-1].strip():
            fields.pop()
        try:
            goal = parse_goal(fields, dimension, where)
            t = seconds(record["t"], where) if record.get("t", "").strip() else None
        except InputFaults as error:
            faults += [f"{where}: {fault}" for fault in error.faults]
        else:
            yield GoalRow(where, *goal, t, record.get("previous", "").strip())
            count += 1
    if faults or not count:
        raise InputFaults(path, faults or ["no goals"])


def seconds(text: str, where: str) -> float:
    try:
        return number(text, sys.float_info.max, 0.0)
    except ValueError as error:
        raise InputFaults(Path(where), [f"t [s]: {error}"]) from None


def parse_goal(fields: Sequence[str], dimension: int, where: str) -> tuple[list[float], Orientation]:
    """Parses the fields of a goal, X,Y[,TH] or X,Y,Z[,QX,QY,QZ,QW], of an option or line that messages name.

    Returns:
        Position, shape (dimension,), and orientation: an angle [rad], a unit quaternion x, y, z, w, or None.

    Raises:
        InputFaults: they are no goal.
    """
    if len(fields) not in (dimension, 3 if dimension == 2 else 7):
        form = "X,Y or X,Y,TH is needed, 2 or 3" if dimension == 2 else "X,Y,Z or X,Y,Z,QX,QY,QZ,QW is needed, 3 or 7"
        raise InputFaults(Path(where), [f"{','.join(fields)!r} is no goal; {form} numbers"])
    most = [LARGEST] * dimension + [LARGEST_ANGLE] * (len(fields) - dimension)
    try:
        goal = list(map(number, fields, most))
    except ValueError as error:
        raise InputFaults(Path(where), [str(error)]) from None
    position, turned = goal[:dimension], goal[dimension:]
    if len(turned) == 4 and abs((length := math.hypot(*turned)) - 1.0) > UNIT:
        words = f"{','.join(fields)!r}: a quaternion of length 1 is needed, got one of length {length:.4g}"
        raise InputFaults(Path(where), [words])
    return position, None if not turned else turned[0] if dimension == 2 else turned
