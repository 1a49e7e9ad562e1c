"""Which inputs are the end-stops of which actuator: by the inputs that change when it moves, and when they do."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

from hyperbit.controller.armfile.commissioned import Sighting
from hyperbit.controller.armfile.locks import STATES
from hyperbit.controller.commission.findings import Finding, Lines, place, shown

FIELDS = ("input_contracted", "input")  # by the end at which it reads 1


class Edge(NamedTuple):
    """The last level of an input after a motion, and the time of its last change [s]."""

    level: int
    seconds: float


def find_end_stops(
    old: Mapping[str, Lines], sightings: Sequence[Sighting], findings: list[Finding]
) -> dict[str, Lines]:
    """Returns the end-stops of each actuator by field: those that change with it, else those of the file."""
    lines = {
        f"{label}.{name}": line for label, own in old.items() for name, line in own.items() if line.kind == "input"
    }
    edges: dict[str, dict[str, dict[int, Edge]]] = {label: {} for label in old}  # by actuator, line and new state
    for seen in sightings:
        changed = {
            change.line: Edge(change.level, change.seconds)
            for change in seen.changes
            if change.line in lines and change.level != seen.before.get(change.line, 1 - change.level)
        }
        changed = {line: edge for line, edge in changed.items() if last(seen, line) == edge.level}
        if seen.moved is not None:
            for line, edge in changed.items():
                edges[seen.moved].setdefault(line, {})[seen.to] = edge
        elif changed:
            text = f"{', '.join(changed)} changed, but nothing was seen to move: look again at {seen.actuator}"
            findings.append(Finding("unseen", (seen.actuator,), text, False))
    found: dict[str, Lines] = {label: {} for label in old}
    for label, of in edges.items():
        for line, when in of.items():
            if len(when) == 2 and when[0].level != when[1].level:
                end = int(when[1].seconds > when[0].seconds)  # a switch closes at the end of the way, and opens soon
                inverted = lines[line].inverted != (when[end].level == 0)
                found[label][FIELDS[end]] = lines[line]._replace(field=FIELDS[end], inverted=inverted)
    taken = {at for own in found.values() for at in map(place, own.values())}
    for label, own in old.items():
        watched = {seen.to for seen in sightings if seen.moved == label}
        for end, name in enumerate(FIELDS):
            if name not in own or name in found[label]:
                continue
            if watched == {0, 1} and place(own[name]) in taken and found[label]:
                continue  # its input belongs to another actuator, or to its other end
            if watched == {0, 1}:
                text = f"the end-stop of {label} for {STATES[end]} ({shown(own[name])}) did not"
                findings.append(Finding("dead end-stop", (label,), f"{text} change: check switch and wire", False))
            if place(own[name]) not in taken:
                found[label][name] = own[name]
    return found


def last(seen: Sighting, line: str) -> int | None:
    """Returns the last level of an input after a command; None if it has not changed."""
    return next((change.level for change in reversed(seen.changes) if change.line == line), None)
