"""Rows of numbers that a process collects and writes at its end, so that no I/O disturbs the measurement."""

from pathlib import Path
from types import TracebackType

import numpy as np
from numpy.typing import NDArray

MOST = 200_000  # rows


class Record:
    """Rows of numbers, written to a file at the end of the context; those beyond `MOST` are dropped.

    Args:
        path: path of the file; None: nothing is recorded.
    """

    def __init__(self, path: Path | None, *columns: str) -> None:
        self._path, self._columns = path, columns
        self._rows = np.zeros((MOST if path else 0, len(columns)))  # the first touch of a page costs no more than a row
        self._count = 0

    def note(self, *row: float) -> None:
        if self._count < len(self._rows):
            self._rows[self._count] = row
            self._count += 1

    def __enter__(self) -> "Record":
        self._rows.fill(0.0)  # now, so that no page is new later
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        if self._path is not None:
            columns = {name: self._rows[: self._count, k] for k, name in enumerate(self._columns)}
            np.savez(self._path, **columns)


def read(path: Path) -> dict[str, NDArray[np.float64]]:
    """Returns the columns of a record by name, each of shape (rows,)."""
    with np.load(path) as file:
        return {name: file[name] for name in file.files}
