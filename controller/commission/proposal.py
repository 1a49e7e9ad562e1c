"""The proposal: the arm's file with other wiring, its comments and order kept; as a text and as a diff."""

from __future__ import annotations

import difflib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from hyperbit.controller.armfile.documents import MOST_YAML, read_text
from hyperbit.controller.armfile.places import compose, named_entry
from hyperbit.controller.armfile.settings import ActuatorSettings, BitSettings, InputSettings

if TYPE_CHECKING:
    import yaml

FIELDS = ("bus", "node", "output", "output_off", "input", "input_contracted")


class Edit(NamedTuple):
    """Characters of a text from `begin` to `end` that become `text`."""

    begin: int
    end: int
    text: str


def proposed_text(
    file: Path, old: Sequence[ActuatorSettings], new: Mapping[str, ActuatorSettings], travel: str | None
) -> str | None:
    """Returns the text of an arm's file with the entries `new`, by label; None if its entries are not in the file.

    Args:
        file: the arm's file.
        old: its entries, in the order of the file.
        new: the entries that were found, by label.
        travel: its new travel time, as YAML; None: as it is.
    """
    text, root = read_text(file, MOST_YAML), compose(file)
    entry = named_entry(root, "actuators")
    rows = getattr(entry[1], "value", []) if entry is not None else []
    if len(rows) != len(old) or not all(hasattr(row, "value") and named_entry(row, "module") for row in rows):
        return None
    edits: list[Edit] = []
    for row, before in zip(rows, old, strict=True):
        after = new[f"{before.module}.{before.actuator}"]
        changed = [field for field in FIELDS if getattr(after, field) != getattr(before, field)]
        edits += [field_edit(text, row, field, getattr(after, field)) for field in changed]
    if travel is not None:
        edits.append(travel_edit(text, root, travel))
    for edit in sorted(edits, reverse=True):
        text = text[: edit.begin] + edit.text + text[edit.end :]
    return text


def field_edit(text: str, row: yaml.MappingNode, field: str, value: object) -> Edit:
    """Returns the edit that gives a field of a row another value, adds it, or takes it away."""
    found = named_entry(row, field)
    last = end_of(text, row.value[-1][1])
    if found is None:
        if row.flow_style:
            return Edit(last, last, f", {field}: {written(value)}")
        return Edit(last, last, f"\n{' ' * row.value[0][0].start_mark.column}{field}: {written(value)}")
    key, node = found
    if value is not None:
        return Edit(node.start_mark.index, end_of(text, node), written(value))
    place = [entry[0] for entry in row.value].index(key)  # never the first: that is `module` or another needed field
    return Edit(end_of(text, row.value[place - 1][1]), end_of(text, node), "")


def travel_edit(text: str, root: yaml.Node | None, travel: str) -> Edit:
    found = named_entry(root, "travel_time")
    if found is not None:
        return Edit(found[1].start_mark.index, end_of(text, found[1]), travel)
    key, _ = named_entry(root, "actuators") or (None, None)
    begin = 0 if key is None else key.start_mark.index
    end = ", " if getattr(root, "flow_style", False) else "\n"  # JSON is YAML in flow style
    return Edit(begin, begin, f"travel_time: {travel}{end}")


def end_of(text: str, node: yaml.Node) -> int:
    """Returns the end of a value; YAML counts the space behind a block as a part of it."""
    begin: int = node.start_mark.index
    return begin + len(text[begin : node.end_mark.index].rstrip())


def written(value: object) -> str:
    """Returns a value of a row as YAML on one line."""
    match value:
        case InputSettings(bit, inverted, board):
            words = [f"bit: {bit}", *["inverted: true"] * inverted, *([] if board is None else [f"board: {board}"])]
            return "{" + ", ".join(words) + "}"
        case BitSettings(bit, inverted):
            return f"{{bit: {bit}, inverted: true}}" if inverted else str(bit)
        case _:
            return str(value)


def diff(file: Path, before: str, after: str) -> str:
    lines = before.splitlines(keepends=True), after.splitlines(keepends=True)
    return "".join(difflib.unified_diff(*lines, str(file), f"{file} (proposed)", n=1))
