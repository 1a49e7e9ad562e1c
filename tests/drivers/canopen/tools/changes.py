"""Changes of the text of the simulated board's EDS."""

from __future__ import annotations

import re
from collections.abc import Callable

from hyperbit.drivers.simulation.dictionary import EDS

TEXT = EDS.read_text()
Change = Callable[[str], str]  # of a text


def put(section: str, line: str) -> Change:
    def change(text: str) -> str:
        start = text.index(f"[{section}]\n")
        end = text.find("\n[", start) % (len(text) + 1)
        part, key = text[start:end].rstrip(), line.partition("=")[0]
        changed = re.sub(rf"^{key}=.*$", lambda _: line, part, count=1, flags=re.MULTILINE)
        return text[:start] + (changed if f"\n{key}=" in part else f"{part}\n{line}") + text[end:]

    return change


def drop(*sections: str) -> Change:
    def change(text: str) -> str:
        for section in sections:
            text = re.sub(rf"^\[{section}(sub\w+)?\]\n(?:(?!\[).*\n?)*", "", text, flags=re.MULTILINE)
        return text

    return change


def swap(old: str, new: str, count: int = -1) -> Change:
    def change(text: str) -> str:
        assert old in text, old
        return text.replace(old, new, count)

    return change


def add(text: str) -> Change:
    return lambda before: f"{before.rstrip()}\n\n{text}\n"


def both(*changes: Change) -> Change:
    def change(text: str) -> str:
        for one in changes:
            text = one(text)
        return text

    return change


def compact(index: str, access: str, mapping: int, value: str = "", kind: int = 8, count: str = "8") -> Change:
    """Describes an array by CompactSubObj."""
    keys = f"ObjectType=0x{kind}\nDataType=0x0005\nAccessType={access}\nDefaultValue={value}\nPDOMapping={mapping}"
    return both(drop(index), add(f"[{index}]\nParameterName=v\n{keys}\nCompactSubObj={count}"))


def without(key: str) -> Change:
    return lambda text: re.sub(rf"^{key}=.*\n", "", text, flags=re.MULTILINE)
