"""The file of a study: a header, a line for each design, then a line for each arm that is judged again.

A study goes on after the lines that are whole. A damaged file is set aside, and the study begins again.
"""

import json
import logging
import os
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from importlib import metadata
from pathlib import Path
from typing import Any, BinaryIO

from msgspec import Struct

from hyperbit.controller.decoding.decoding import Unreadable, convert, decode
from hyperbit.controller.design.search import Evaluation, Figures, optuna_version
from hyperbit.controller.design.study import Study
from hyperbit.controller.design.template import Value
from hyperbit.controller.host.files import set_aside
from hyperbit.controller.host.keeper import FileInUse, lock_file
from hyperbit.controller.studies.lines import write_line
from hyperbit.controller.studies.shares import StudyFailed

log = logging.getLogger(__name__)

OTHER = {
    "study": "another study",
    "seed": "another seed",
    "hyperbit": "another version of hyperbit",
    "optuna": "another version of optuna",
}


class DesignLine(Struct, forbid_unknown_fields=True):
    design: int
    values: dict[str, Value]
    figures: Figures
    impossible: int


class FinalLine(Struct, forbid_unknown_fields=True):
    """An arm that was judged again: the number of a design, or the name of an arm for comparison."""

    final: int | str
    figures: Figures


class Kept:
    """The results of a study: those of its file, and new ones, which are written to it.

    Attributes:
        designs: the designs so far.
        finals: the arms that were judged again so far.
    """

    def __init__(self, path: Path | None = None) -> None:
        self.designs, self.finals = list[Evaluation](), list[FinalLine]()
        self._path, self._file = path, None

    _file: BinaryIO | None

    def open(self, header: Mapping[str, object], count: int) -> BinaryIO:
        """Opens the file behind the lines that are kept, for a study of `count` designs.

        Raises:
            StudyFailed: the file belongs to something else.
            OSError: it cannot be read or written.
        """
        path, first = self._path or Path(), json.dumps(header).encode() + b"\n"
        content = path.read_bytes() if path.exists() else b""
        if first.startswith(content):  # no file yet, or the header was half written
            path.write_bytes(first)
        else:
            check_header(path, content.partition(b"\n")[0], header)
            try:
                os.truncate(path, self._read(content, count))
            except Unreadable as error:
                self.designs.clear()
                self.finals.clear()
                if set_aside(path, error, "the study begins again") is None:
                    raise StudyFailed(f"{path} is damaged ({error}), and cannot be renamed") from None
                path.write_bytes(first)
        self._file = path.open("a+b")
        return self._file

    def _read(self, content: bytes, count: int) -> int:
        """Reads the lines of a file; those of arms judged again if all of `count` designs are there.

        Returns:
            The number of bytes that are kept.

        Raises:
            Unreadable: a line is damaged.
            StudyFailed: there are more designs than wanted.
        """
        lines = content.split(b"\n")[:-1]  # the last is empty, or was half written
        size = ends = len(lines[0]) + 1
        for number, line in enumerate(lines[1:], 2):
            size += len(line) + 1
            try:
                value = decode(line, dict[str, Any])
                kind: type[DesignLine] | type[FinalLine] = DesignLine if "design" in value else FinalLine
                own = convert(value, kind)
            except Unreadable as error:
                raise Unreadable(f"line {number}: {error}") from None
            if isinstance(own, FinalLine):
                self.finals.append(own)
                continue
            if self.finals or own.design != len(self.designs) + 1:
                raise Unreadable(f"line {number} is design {own.design}, after {len(self.designs)} designs")
            self.designs.append(Evaluation(own.design, own.values, own.figures, own.impossible))
            ends = size
        if len(self.designs) > count:
            words = f"it has {len(self.designs)} designs: ask for as many evaluations, or give the name of a new file"
            raise StudyFailed(f"{self._path}: {words}")
        if len(self.designs) < count:  # the arms judged again are those of fewer designs
            self.finals.clear()
            return ends
        return size

    def add(self, one: Evaluation) -> None:
        """Keeps a design."""
        if one.design > len(self.designs):
            self.designs.append(one)
            self._write(one._asdict())

    def final(self, k: int, name: int | str) -> Figures | None:
        """Returns the figures of the arm k that is judged again; None if they are not known.

        Raises:
            StudyFailed: the file has another arm there.
        """
        if k >= len(self.finals):
            return None
        if (other := self.finals[k].final) != name:
            raise StudyFailed(f"{self._path} has {other} in place of {name}: give the name of a new file")
        return self.finals[k].figures

    def add_final(self, name: int | str, figures: Figures) -> None:
        """Keeps an arm that was judged again."""
        self.finals.append(FinalLine(name, figures))
        self._write({"final": name, "figures": figures})

    def _write(self, line: Mapping[str, object]) -> None:
        if self._file is None or self._path is None:
            return
        try:
            if write_line(self._path, self._file, line):
                log.warning("%s was deleted or moved: it is written again", self._path)
        except OSError as error:
            words = f"{self._path} cannot be written: {error.strerror}; the same study then goes on where it ended"
            raise StudyFailed(words) from None


@contextmanager
def kept(path: Path | None, study: Study, seed: int, count: int) -> Iterator[Kept]:
    """Opens the file of a study of `count` designs, or creates it; without a path nothing is written.

    Raises:
        StudyFailed: the file belongs to something else, is in use, or cannot be written.
    """
    found = Kept(path)
    header = {"study": study.digest, "seed": seed, "hyperbit": metadata.version("hyperbit"), "optuna": optuna_version()}
    with ExitStack() as closing:
        try:
            if path is not None:
                lock = path.with_name(f".{path.name}.lock")
                used = f"{path}: end the other study, or name another file: process"
                closing.callback(os.close, lock_file(lock, used))
                closing.callback(lock.unlink, missing_ok=True)
                closing.enter_context(found.open(header, count))
        except FileInUse as error:
            raise StudyFailed(str(error)) from None
        except OSError as error:
            raise StudyFailed(f"{path} cannot be written: {error.strerror}") from None
        yield found


def check_header(path: Path, line: bytes, header: Mapping[str, object]) -> None:
    try:
        given = decode(line, dict[str, Any])
    except Unreadable:
        given = {}
    if given.keys() != header.keys():
        raise StudyFailed(f"{path}: it holds no results of a study of designs: give the name of a new file")
    if other := [words for name, words in OTHER.items() if given[name] != header[name]]:
        raise StudyFailed(f"{path}: its results belong to {' and '.join(other)}: give the name of a new file")
