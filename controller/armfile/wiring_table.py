"""The wiring of an arm as a CSV file beside the arm's file: a row for each actuator, a column for each field.

A cell of an output or input is its bit, such as `3`, `3 inverted`, or `can0/9:3 inverted` for an end-stop on another
board. An empty cell leaves the field out.
"""

import re
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from hyperbit.controller.armfile.choices import NUMBER, unknown_field
from hyperbit.controller.armfile.csv_files import CsvFile, read_beside

FIELD = "wiring"
TEXTS = ("actuator", "bus", "on_loss", "stuck")
BITS = ("output", "output_off", "input", "input_contracted")
CELL = re.compile(r"(?:(?P<board>\S+/\S+):)?(?P<bit>[0-9]{1,6})(?P<inverted>\s+inverted)?")
MOST_ACTUATORS = 10_000
ROW_OF = re.compile(r"actuators\[(\d{1,9})\]\.?")


def read_wiring(folder: Path, name: str, known: Iterable[str], faults: list[str]) -> list[dict[str, Any]]:
    """Returns `actuators` of an arm's file from a CSV file in `folder`; `known` are the fields of an actuator."""
    table = read_beside(folder, name, FIELD, MOST_ACTUATORS, faults)
    if table is None:
        return []
    fields = set(known)
    faults += [
        f"{FIELD}: {name}: {column}: {unknown_field(column, fields)}"
        for column in table.columns
        if column not in fields
    ]
    if not table.rows:
        faults.append(f"{FIELD}: {name}: a row for each actuator is needed, got none")
    return [] if faults else [row_values(table, row.fields) for row in table.rows]


def row_values(table: CsvFile, cells: Sequence[str]) -> dict[str, Any]:
    named = zip(table.columns, (cell.strip() for cell in cells), strict=True)
    return {column: cell_value(column, cell) for column, cell in named if cell}


def cell_value(column: str, cell: str) -> Any:
    """Returns the value that YAML would have for a cell; a cell of another form stays text, and its check tells."""
    if column in BITS and (match := CELL.fullmatch(cell)):
        board = {} if match["board"] is None else {"board": match["board"]}
        return {"bit": int(match["bit"]), "inverted": match["inverted"] is not None, **board}
    if column in TEXTS or column in BITS:
        return cell
    number = NUMBER.fullmatch(cell)
    if number is None or number[2]:
        return cell
    return int(cell) if cell.isdecimal() and len(cell) < 10 else float(number[1])


def wiring_cell(bit: int, *, inverted: bool = False, board: str | None = None) -> str:
    """Returns the cell of an output or input; read_wiring reads it."""
    return f"{board}:" * (board is not None) + f"{bit}" + " inverted" * inverted


def row_faults(folder: Path, name: str, faults: Sequence[str]) -> list[str]:
    """Returns faults with a line of the CSV file in place of `actuators[k]`: "wiring: w.csv line 3: node: ..."."""
    table = read_beside(folder, name, FIELD, MOST_ACTUATORS, [])
    lines = [] if table is None else [row.line for row in table.rows]

    def placed(fault: str) -> str:
        match = ROW_OF.match(fault)
        if match is None or int(match[1]) >= len(lines):
            return fault
        return f"{FIELD}: {name} line {lines[int(match[1])]}: {fault[match.end() :].removeprefix(': ')}"

    return [placed(fault) for fault in faults]
