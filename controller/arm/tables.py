"""Measured frames in CSV files, one row for each state; each fault is reported with its line."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from hyperbit.controller.armfile.choices import LARGEST, LARGEST_ANGLE, number
from hyperbit.controller.armfile.csv_files import check_states, read_states
from hyperbit.controller.armfile.strict import UNIT
from hyperbit.controller.manipulator import frames

PLANAR, SPATIAL = ("x", "y", "th"), ("x", "y", "z", "qx", "qy", "qz", "qw")


@dataclass(frozen=True, eq=False)
class Table:
    frames: list[frames.Frame]
    planar: bool


def read_table(folder: Path, name: str, path: str, faults: list[str]) -> Table | None:
    """Returns the frames in a CSV file, or None with the faults appended.

    The first line names the columns, in any order: x, y, th [rad], or x, y, z and a quaternion qx, qy, qz, qw. `folder`
    is that of the arm's file; each fault begins with `path`, the field that names the CSV file.
    """
    before, table = len(faults), read_states(folder, name, path, faults)
    if table is None:
        return None
    columns = table.columns
    if sorted(columns) not in (sorted(PLANAR), sorted(SPATIAL)):
        wanted, given = f"{','.join(PLANAR)} or {','.join(SPATIAL)}", ",".join(columns) or "none"
        faults.append(f"{path}: {name}: columns {wanted} are needed, got {given}")
        return None
    rows = [read_row(row.fields, columns, f"{path}: {name} line {row.line}", faults) for row in table.rows]
    check_states(table, name, path, faults)
    found = [frame for frame in rows if frame is not None]
    return Table(found, "th" in columns) if len(faults) == before else None


def read_row(row: Sequence[str], columns: Sequence[str], where: str, faults: list[str]) -> frames.Frame | None:
    """Returns the frame of a row, or None and a fault."""
    values: dict[str, float] = {}
    for column, text in zip(columns, row, strict=True):
        most = LARGEST_ANGLE if column == "th" else LARGEST
        try:
            values[column] = number(text, most)
        except ValueError as error:
            faults.append(f"{where}: {column}: {error}")
            return None
    if "th" in values:
        return frames.planar(values["x"], values["y"], values["th"])
    quaternion = [values[name] for name in SPATIAL[3:]]
    if abs(math.hypot(*quaternion) - 1.0) > UNIT:
        faults.append(f"{where}: a quaternion qx, qy, qz, qw of length 1 is needed, got {quaternion}")
        return None
    return frames.spatial([values["x"], values["y"], values["z"]], quaternion)
