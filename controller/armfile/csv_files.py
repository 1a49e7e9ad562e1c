"""CSV files: the first line names the columns, each further line is a row with its line number."""

import csv
import io
import itertools
from collections.abc import Iterator
from pathlib import Path, PurePath
from typing import NamedTuple, TextIO

from hyperbit.controller.armfile.strict import InputFaults
from hyperbit.controller.host.files import MOST, open_file

MOST_STREAMED = 1_000_000_000  # bytes of a file whose rows are read one by one: some 20 million goals
MOST_LINE = 100_000  # characters of a line
MOST_STATES = 4096  # rows of a table of measured frames
COMMAS = "a number has a decimal point, such as 0.3, and a text with commas stands in quotes"


class CsvRow(NamedTuple):
    """A field for each column, "" where the row ends before, and the number of the row's last line."""

    line: int
    fields: list[str]


class CsvFile(NamedTuple):
    """The content of a file."""

    columns: list[str]  # names in the first line; empty for an empty file
    rows: list[CsvRow]  # rows in the file's order, without empty lines


def csv_rows(path: Path, most: int = MOST_STREAMED) -> Iterator[CsvRow]:
    """Yields the rows of a CSV file as they are read, the names of the columns first, and no empty lines.

    Args:
        path: of the file.
        most: most bytes of the file.

    Raises:
        InputFaults: the file cannot be read, a column occurs twice, or a row has more fields than there are columns.
    """
    try:
        file = open_file(path, most)
    except (OSError, ValueError) as error:
        raise InputFaults(path, [f"cannot be read: {getattr(error, 'strerror', None) or error}"]) from None
    # spreadsheets write a byte order mark
    with io.TextIOWrapper(file, newline="", encoding="utf-8-sig") as text:
        yield from rows_of(path, text)


def rows_of(path: Path, text: TextIO) -> Iterator[CsvRow]:
    """Yields the rows of the text of a CSV file; see `csv_rows`."""
    try:
        reader = csv.reader(bounded_lines(text), skipinitialspace=True, strict=True)
        columns = [column.strip() for column in next(reader, [])]
        check_columns(path, columns)
        yield CsvRow(1, columns)
        for fields in reader:
            if len(fields) > len(columns):
                fault = f"line {reader.line_num}: {len(columns)} fields are needed, got {len(fields)}; {COMMAS}"
                raise InputFaults(path, [fault])
            if fields:
                yield CsvRow(reader.line_num, fields + [""] * (len(columns) - len(fields)))
    except InputFaults:
        raise
    except (OSError, ValueError, csv.Error) as error:
        reason = error.strerror if isinstance(error, OSError) else error
        reason = f"{error}; save it as UTF-8" if isinstance(error, UnicodeDecodeError) else reason
        raise InputFaults(path, [f"cannot be read: {reason}"]) from None


def bounded_lines(file: TextIO) -> Iterator[str]:
    """Yields the lines of a file. Raises ValueError if one is too long for a line of a table."""
    for number in itertools.count(1):
        if not (line := file.readline(MOST_LINE + 1)):
            return
        if len(line) > MOST_LINE:
            raise ValueError(f"line {number} has more than {MOST_LINE} characters; is it a CSV file?")
        yield line


def check_columns(path: Path, columns: list[str]) -> None:
    """Raises InputFaults if a column occurs twice, commas do not separate the columns, or the file has another form."""
    if columns and columns[0].startswith(("{", "[")):
        raise InputFaults(path, ["a CSV file is needed; this file looks like JSON"])
    faults = [f"column {name!r} occurs twice" for k, name in enumerate(columns) if name in columns[:k]]
    for mark, name in ((";", "semicolons"), ("\t", "tabs")):
        if any(mark in column for column in columns):
            faults.append(f"{name} separate the columns: write commas, and numbers with a decimal point")
    if faults:
        raise InputFaults(path, faults)


def read_csv(path: Path, most: int | None = None) -> CsvFile:
    """Returns the content of a CSV file.

    Args:
        path: of the file.
        most: most rows to accept; one more is read, so that the caller sees that the file has more. None: no limit.

    Raises:
        InputFaults: as in `csv_rows`.
    """
    rows = csv_rows(path, MOST)
    return CsvFile(next(rows).fields, list(itertools.islice(rows, None if most is None else most + 1)))


def read_states(folder: Path, name: str | None, field: str, faults: list[str]) -> CsvFile | None:
    """Returns a table with a row for each state beside an arm's file; None with a fault appended. See `read_beside`."""
    return read_beside(folder, name, field, MOST_STATES, faults)


def read_beside(folder: Path, name: str | None, field: str, most: int, faults: list[str]) -> CsvFile | None:
    """Returns a table beside an arm's file; None with a fault appended.

    Args:
        folder: of the arm's file.
        name: of the CSV file, relative to the folder.
        field: of the arm's file that names the CSV file.
        most: most rows to accept; one more is read.
        faults: appended to, each beginning with `field`.
    """
    if name is None or PurePath(name).is_absolute() or ".." in PurePath(name).parts or not name.endswith(".csv"):
        faults.append(f"{field}: a CSV file beside the arm's is needed, such as measured.csv, got {name!r}")
        return None
    try:
        return read_csv(folder / name, most)
    except InputFaults as error:
        faults += [f"{field}: {name} {fault}" for fault in error.faults]
        return None


def check_states(table: CsvFile, name: str | None, field: str, faults: list[str]) -> None:
    """Appends a fault if a table has too few or too many rows. For the arguments see `read_beside`."""
    if not 2 <= len(table.rows) <= MOST_STATES:
        faults.append(f"{field}: {name}: 2 to {MOST_STATES} rows are needed, a state each, got {len(table.rows)}")
