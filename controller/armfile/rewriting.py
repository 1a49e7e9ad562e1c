"""New numbers in the text of a YAML file: comments, order, layout and units stay."""

from __future__ import annotations

from collections.abc import Mapping, Set
from typing import Any, NamedTuple

from hyperbit.controller.armfile.choices import NUMBER
from hyperbit.controller.armfile.documents import build_loader
from hyperbit.controller.armfile.units import factors

Key = str | int
Place = tuple[Key, ...]  # keys and indices from the top of the file


class Edit(NamedTuple):
    start: int  # of the replaced characters
    end: int
    text: str


def rewritten(text: str, fields: Mapping[str, Any], places: Set[Place]) -> str:
    """Returns the text of a YAML file with new values at some places.

    A part that has another form than in the file, such as a list of another length, is written as a whole, and loses
    the comments in it.

    Args:
        text: of the file, which is valid, with a mapping at its top.
        fields: new values of fields at the top, in the file's unit and radians.
        places: of the new numbers in `fields`; all other values stay as they are in the text.
    """
    import yaml

    touched = {place[:k] for place in places for k in range(len(place) + 1)}
    top: Any = yaml.compose(text, build_loader())
    unit = next((node.value for key, node in top.value if key.value == "unit"), None)
    known = {name: factor for table in factors(unit).values() for name, factor in table.items()}
    edits = changes(text, top, in_units(top, dict(fields), known), (), touched)
    for edit in sorted(edits, reverse=True):
        text = text[: edit.start] + edit.text + text[edit.end :]
    return text


# A node is one of PyYAML's, whose types have no attributes of the three kinds.
def in_units(node: Any, value: Any, known: Mapping[str, float]) -> Any:
    """Returns a value with the units that the texts of its numbers have in a node, such as "30.02 deg"."""
    if node.id == "mapping" and isinstance(value, dict):
        children = {key.value: child for key, child in node.value}
        return {key: in_units(children[key], part, known) if key in children else part for key, part in value.items()}
    if node.id == "sequence" and isinstance(value, list) and len(value) == len(node.value):
        return [in_units(child, part, known) for child, part in zip(node.value, value, strict=True)]
    match = NUMBER.fullmatch(node.value.strip()) if node.id == "scalar" else None
    if match is None or match[2] not in known or not isinstance(value, float | int):
        return value
    return f"{value / known[match[2]]:.15g} {match[2]}"


def changes(text: str, node: Any, value: Any, place: Place, touched: Set[Place]) -> list[Edit]:
    """Returns the edits that bring the touched parts of a value into its node."""
    if node.id == "mapping" and isinstance(value, dict):
        known = {key.value: child for key, child in node.value}
        if place and not known.keys() <= value.keys():  # of a table, whose frames are written out
            return [whole(text, node, value)]
        edits = list[Edit]()
        given = {key: part for key, part in value.items() if (*place, key) in touched}
        for key in known.keys() & given.keys():
            edits += changes(text, known[key], given[key], (*place, key), touched)
        new = {key: part for key, part in given.items() if key not in known}
        return [*edits, added(text, node, new)] if new else edits
    if node.id == "sequence" and isinstance(value, list) and len(value) == len(node.value):
        edits = []
        for k, (child, part) in enumerate(zip(node.value, value, strict=True)):
            edits += changes(text, child, part, (*place, k), touched) if (*place, k) in touched else []
        return edits
    return [] if same(node, value) else [whole(text, node, value)]


def same(node: Any, value: Any) -> bool:
    """Returns whether the text of a node has a number already."""
    if node.id != "scalar" or not isinstance(value, float | int | str):
        return False
    old, new = NUMBER.fullmatch(node.value.strip()), NUMBER.fullmatch(str(value))
    return old is not None and new is not None and (float(old[1]), old[2]) == (float(new[1]), new[2])


def whole(text: str, node: Any, value: Any) -> Edit:
    """Returns the edit that replaces a node by a value; a list of mappings has a line for each."""
    start, end = node.start_mark.index, end_of(node)
    if isinstance(value, list) and value and isinstance(value[0], dict) and not node.flow_style:
        between = "\n" + " " * node.start_mark.column
        return Edit(start, end, between.join(f"- {flow(part)}" for part in value))
    block = node.id != "scalar" and not node.flow_style
    return Edit(start, end, f"{'  ' * block}{flow(value)}")  # deeper than the key of a block that begins below its key


def added(text: str, node: Any, fields: Mapping[Key, Any]) -> Edit:
    """Returns the edit that adds fields at the end of a mapping."""
    lines = [f"{key}: {flow(value)}" for key, value in fields.items()]
    if node.flow_style:
        place = node.end_mark.index - 1
        return Edit(place, place, f"{', ' if node.value else ''}{', '.join(lines)}")
    place = text.find("\n", end_of(node))
    place = len(text) if place < 0 else place
    return Edit(place, place, "".join(f"\n{' ' * node.start_mark.column}{line}" for line in lines))


def end_of(node: Any) -> int:
    """Returns the index after the last character of a node, without the comments that follow."""
    if node.id == "scalar" or node.flow_style or not node.value:
        return int(node.end_mark.index)
    last = node.value[-1]
    return end_of(last[1] if isinstance(last, tuple) else last)


def flow(value: Any) -> str:
    """Returns a value in YAML on one line."""
    import yaml

    text: str = yaml.safe_dump(value, default_flow_style=True, sort_keys=False, width=1_000_000, allow_unicode=True)
    return text.removesuffix("\n").removesuffix("\n...")
