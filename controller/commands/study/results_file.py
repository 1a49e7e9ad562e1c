"""Files of results as JSON lines, written as they come, which a study that was interrupted goes on with."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from importlib import metadata
from pathlib import Path
from types import TracebackType
from typing import Any, BinaryIO

from hyperbit.controller.armfile.strict import InputFaults

WORDS = {
    "study": "another command",
    "hyperbit": "another version of hyperbit",
    "arm": "another arm file",
    "goals": "another file of goals",
    "options": "other options",
}


class ResultsFile:
    """An open file of results: a header, which names what they belong to, and a line for each result.

    Attributes:
        done: number of goals whose results were in the file when it was opened.

    Args:
        file: open for writing, at its end.
        done: see above.
    """

    def __init__(self, file: BinaryIO, done: int) -> None:
        self._file, self.done = file, done

    def __enter__(self) -> ResultsFile:
        """Returns the file."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Closes the file."""
        self._file.close()

    def write(self, line: Mapping[str, Any]) -> None:
        """Appends a result."""
        self._file.write(json.dumps(line).encode() + b"\n")
        self._file.flush()


def open_results(path: Path, about: Mapping[str, Any], ends: Iterator[int]) -> ResultsFile:
    """Opens a file of results to go on with it; creates it if it is missing.

    A line that was half written, and the results of a part that was not finished, are cut.

    Args:
        path: of the file.
        about: what the results belong to: study, arm, goals and options.
        ends: numbers of goals at which a study may go on, rising.

    Raises:
        InputFaults: the file has other content, or cannot be written.
    """
    header = {**about, "hyperbit": metadata.version("hyperbit")}
    try:
        file = path.open("r+b" if path.exists() else "w+b")
    except OSError as error:
        raise InputFaults(path, [f"cannot be written: {error.strerror}"]) from None
    try:
        first = file.readline()
        if not first.endswith(b"\n") and (json.dumps(header) + "\n").encode().startswith(first):
            file.seek(0)
            file.truncate()
            results = ResultsFile(file, 0)
            results.write(header)
            return results
        check_header(path, first, header)
        done, size = finished(path, file, len(first), ends)
        file.seek(size)
        file.truncate()
        return ResultsFile(file, done)
    except InputFaults:
        file.close()
        raise


def check_header(path: Path, line: bytes, header: Mapping[str, Any]) -> None:
    """Checks that a file belongs to this study.

    Raises:
        InputFaults: it does not.
    """
    try:
        found = json.loads(line)
    except ValueError:
        found = None
    if not isinstance(found, dict) or found.keys() != header.keys():
        raise InputFaults(path, ["it holds no results of a study: give the name of a new file"])
    other = [words for name, words in WORDS.items() if found[name] != json.loads(json.dumps(header[name]))]
    if other:
        raise InputFaults(path, [f"its results belong to {' and '.join(other)}: give the name of a new file"])


def finished(path: Path, file: BinaryIO, size: int, ends: Iterator[int]) -> tuple[int, int]:
    """Returns the number of finished goals, and the size of the file up to them.

    Args:
        path: of the file, for messages.
        file: open after the header.
        size: of the header [bytes].
        ends: numbers of goals at which a study may go on, rising.

    Raises:
        InputFaults: a line is damaged, or there are more results than goals.
    """
    done, whole, goals, end = 0, size, 0, next(ends)
    for number, line in enumerate(file, 2):
        if not line.endswith(b"\n"):
            break
        try:
            between = json.loads(line).get("between", False)
        except (ValueError, AttributeError):
            raise InputFaults(path, [f"line {number} is damaged: give the name of a new file"]) from None
        if goals == end and (end := next(ends, 0)) == 0:
            raise InputFaults(path, [f"line {number}: there are more results than goals"])
        size, goals = size + len(line), goals + (not between)
        if goals == end:
            done, whole = goals, size
    return done, whole
