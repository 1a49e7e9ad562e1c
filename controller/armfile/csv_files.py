"""CSV files: the first line names the columns, each further line is a row with its line number."""

import csv
from collections.abc import Iterator
from itertools import islice, zip_longest
from pathlib import Path, PurePath
from typing import NamedTuple

from hyperbit.controller.armfile.strict import InputFaults

MOST_STATES = 4096  # rows of a table of measured frames


class CsvRow(NamedTuple):
    """The fields of a row, and the number of its last line."""

    line: int
    fields: list[str]


class CsvFile(NamedTuple):
    """The content of a file."""

    columns: list[str]  # names in the first line; empty for an empty file
    rows: list[CsvRow]  # rows in the file's order, without empty lines

    def records(self) -> Iterator[tuple[int, dict[str, str]]]:
        """Yields line number and fields by column of each row; missing fields are empty, further fields are ignored."""
        for row in self.rows:
            yield row.line, record_of(self.columns, row)


def csv_rows(path: Path) -> Iterator[CsvRow]:
    """Yields the rows of a CSV file as they are read, the names of the columns first; an empty line has no fields.

    Raises:
        InputFaults: the file cannot be read.
    """
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:  # spreadsheets write a byte order mark
            reader = csv.reader(file, skipinitialspace=True, strict=True)
            yield CsvRow(1, [column.strip() for column in next(reader, [])])
            for fields in reader:
                yield CsvRow(reader.line_num, fields)
    except (OSError, ValueError, csv.Error) as error:
        reason = error.strerror if isinstance(error, OSError) else error
        raise InputFaults(path, [f"cannot be read: {reason}"]) from None


def record_of(columns: list[str], row: CsvRow) -> dict[str, str]:
    """Returns the fields of a row by column; missing fields are empty, further fields are ignored."""
    return dict(zip_longest(columns, row.fields[: len(columns)], fillvalue=""))


def read_csv(path: Path, most: int | None = None) -> CsvFile:
    """Returns the content of a CSV file.

    Args:
        path: of the file.
        most: most rows to accept; one more is read, so that the caller sees that the file has more. None: no limit.

    Raises:
        InputFaults: the file cannot be read.
    """
    rows = csv_rows(path)
    columns, lines = next(rows).fields, islice(rows, None if most is None else most + 1)
    return CsvFile(columns, [row for row in lines if row.fields])


def read_states(folder: Path, name: str | None, field: str, faults: list[str]) -> CsvFile | None:
    """Returns a table beside an arm's file, with a row for each state; None with a fault appended.

    Args:
        folder: of the arm's file.
        name: of the CSV file, relative to the folder.
        field: of the arm's file that names the CSV file.
        faults: appended to, each beginning with `field`.
    """
    if name is None or PurePath(name).is_absolute() or ".." in PurePath(name).parts or not name.endswith(".csv"):
        faults.append(f"{field}: a CSV file beside the arm's is needed, such as measured.csv, got {name!r}")
        return None
    try:
        return read_csv(folder / name, MOST_STATES)
    except InputFaults as error:
        faults += [f"{field}: {name} {fault}" for fault in error.faults]
        return None


def check_states(table: CsvFile, name: str | None, field: str, faults: list[str]) -> None:
    """Appends a fault if a table has too few or too many rows. For the arguments see `read_states`."""
    if not 2 <= len(table.rows) <= MOST_STATES:
        faults.append(f"{field}: {name}: 2 to {MOST_STATES} rows are needed, a state each, got {len(table.rows)}")
