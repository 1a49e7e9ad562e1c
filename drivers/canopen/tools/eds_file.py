"""Reads the text of an EDS or DCF (CiA 306-1).

Makers' files break many rules of CiA 306-1. So the reader requires only the parts that the check uses.
"""

from __future__ import annotations

import re
from typing import NamedTuple

_OBJECT = re.compile(r"(?:0x)?([0-9a-f]{1,4})(?:sub(?:0x)?([0-9a-f]{1,3}))?")
_MODULE = re.compile(r"m\d+(?:subext|fixed(?:obj)?)([0-9a-f]{4})(?:sub[0-9a-f]+)?")
_MODULE_LIST = re.compile(r"m\d+(?:subextends|fixedobjects)")
_COMMENT = re.compile(r"\s*(?:[;#]|//).*")
_NUMBER = re.compile(r"-?(?:0x[0-9a-f]+|[0-9]+)")
_OCTAL = re.compile(r"-?0[0-7]+")
_BOMS = {b"\xff\xfe": "utf-16", b"\xfe\xff": "utf-16", b"\xef\xbb\xbf": "utf-8-sig"}


class UnreadableEds(ValueError):
    """The file cannot be read as an EDS; the text says why."""


class Key(NamedTuple):
    line: int  # number
    name: str
    text: str  # without a comment


Section = dict[str, Key]  # by the key's name in lower case


class EdsFile(NamedTuple):
    objects: dict[int, dict[int | None, Section]]  # by index, and by sub-index; None: the object itself
    others: dict[str, Section]  # by their names in lower case
    of_modules: frozenset[int]  # indices of objects that come with modules of a coupler
    notes: list[str]  # sentences on skipped lines


def read(data: bytes) -> EdsFile:
    """Reads the content of a file. Raises UnreadableEds if it is another kind of file."""
    encoding = next((name for bom, name in _BOMS.items() if data.startswith(bom)), "utf-8")
    text = data.decode(encoding, errors="replace")
    if text.lstrip().startswith("<"):
        raise UnreadableEds("no EDS: it is XML (XDD or XDC). Export the device as EDS, for instance by CANopenEditor")
    return _parse(text)


def _parse(text: str) -> EdsFile:
    """Sorts the lines into sections. The first of equal keys counts; equal sections are one."""
    objects: dict[int, dict[int | None, Section]] = {}
    others: dict[str, Section] = {}
    notes: list[str] = []
    section: Section = {}  # takes the lines before the first section
    title = ""
    for number, line in enumerate(text.splitlines(), 1):
        line = line.strip(" \t\0")
        if not line or line[0] in ";#":
            continue
        if line[0] == "[":
            title = line[1:].partition("]")[0].strip()
            section = _section(title.lower(), objects, others)
            continue
        name, equals, value = (part.strip() for part in line.partition("="))
        if not equals:
            notes.append(f"line {number}, [{title}]: {_short(line)} has no '=', and is skipped")
            continue
        key = Key(number, name, _COMMENT.sub("", value).strip().strip('"'))
        first = section.setdefault(name.lower(), key)
        if first.text != key.text:
            notes.append(
                f"line {number}, [{title}]: {_short(line)} is skipped, for line {first.line} has this key, too"
            )
    modules = {int(found[1], 16) for found in map(_MODULE.fullmatch, others) if found}
    lists = [section for name, section in others.items() if _MODULE_LIST.fullmatch(name)]
    listed = (parse_number(key.text, 0) for section in lists for name, key in section.items() if name.isdecimal())
    return EdsFile(objects, others, frozenset(modules.union(index for index in listed if index)), notes)


def _section(name: str, objects: dict[int, dict[int | None, Section]], others: dict[str, Section]) -> Section:
    found = _OBJECT.fullmatch(name)
    if found is None:
        return others.setdefault(name, {})
    sub = None if found[2] is None else int(found[2], 16)
    return objects.setdefault(int(found[1], 16), {}).setdefault(sub, {})


def parse_number(text: str, node: int) -> int | None:
    """Parses a number of CiA 306-1; returns None if it is invalid.

    It is decimal, hexadecimal with 0x, or octal with 0, and may have `$NODEID`, added by `+`, which stands for `node`.
    """
    total = 0
    for part in text.lower().removeprefix("+").split("+"):
        part = part.strip()
        if part in ("$nodeid", "nodeid"):
            total += node
        elif not _NUMBER.fullmatch(part):
            return None
        elif "x" in part:
            total += int(part, 16)
        else:
            total += int(part, 8 if _OCTAL.fullmatch(part) else 10)
    return total


def _short(line: str) -> str:
    return line if len(line) <= 60 else f"{line[:57]}..."
