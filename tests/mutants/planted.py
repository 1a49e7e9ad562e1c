"""Reads the defects that were planted by hand: lines of the program, and what replaces them.

A defect begins with its file and its title. Lines with - stand in the file exactly once, at any indentation; the lines
with + that follow replace them. A defect may have several such changes.
"""

from __future__ import annotations

import textwrap
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from tests.mutants.sites import Mutant


class Change(NamedTuple):
    old: list[str]
    new: list[str]


def planted(root: Path, folder: Path) -> list[Mutant]:
    """Returns the defects of all files of a folder. Raises ValueError if the program no longer has the lines of one."""
    found = []
    for path in sorted(folder.glob("*.txt")):
        for file, title, changes in _defects(path):
            original = (root / file).read_text()
            source = original
            for change in changes:
                source = _changed(source, change, f"{path.name}: {file}: {title}")
            data = original.encode()
            found.append(Mutant(f"planted::{file}::{title}", file, "planted", data, 0, len(data), source))
    return found


def _defects(path: Path) -> Iterator[tuple[str, str, list[Change]]]:
    file, title, changes = "", "", list[Change]()
    for line in path.read_text().splitlines():
        if line.startswith("-"):
            if not changes or changes[-1].new:
                changes.append(Change([], []))
            changes[-1].old.append(line[2:])
        elif line.startswith("+"):
            changes[-1].new.append(line[2:])
        elif line and not line.startswith("#"):
            if file:
                yield file, title, changes
            file, title = line.split(": ", 1)
            changes = []
    if file:
        yield file, title, changes


def _changed(source: str, change: Change, name: str) -> str:
    lines, size = source.split("\n"), len(change.old)
    places = [k for k in range(len(lines)) if textwrap.dedent("\n".join(lines[k : k + size])).split("\n") == change.old]
    if len(places) != 1:
        raise ValueError(f"{name}: these lines stand in the file {len(places)} times, not once: {change.old}")
    at = places[0]
    indent = min(len(line) - len(line.lstrip()) for line in lines[at : at + size] if line)
    new = textwrap.indent("\n".join(change.new), " " * indent).split("\n")
    return "\n".join([*lines[:at], *new, *lines[at + size :]])
