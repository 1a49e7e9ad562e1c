"""Faults of the wiring, named by comparing the wiring of the file with the wiring that was found."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import NamedTuple

from hyperbit.controller.armfile.terminals import Terminal

Lines = dict[str, Terminal]  # outputs and inputs of an actuator, by field
OUTPUTS, INPUTS = ("output", "output_off"), ("input", "input_contracted")


class Finding(NamedTuple):
    """One fault of the wiring. `proposed`: the proposal mends it; otherwise a person must."""

    kind: str
    actuators: tuple[str, ...]
    text: str
    proposed: bool


def compared(old: Mapping[str, Lines], new: Mapping[str, Lines]) -> Iterator[Finding]:
    """Yields a finding for each difference of two wirings; swaps of whole boards and actuators have one each."""
    outputs = {label: differs(old[label], new[label], OUTPUTS) for label in old}
    inputs = {label: differs(old[label], new[label], INPUTS) for label in old}
    swapped = dict(pairs(old, new, OUTPUTS))
    whole = {
        a: b for a, b in swapped.items() if exchanged(old[a], new[b], INPUTS) and exchanged(old[b], new[a], INPUTS)
    }
    boards = dict.fromkeys(swapped_boards(old, new))
    for one, other in boards:
        of = tuple(label for label, lines in old.items() if lines["output"].board in (one, other))
        text = f"boards {one[0]}/{one[1]} and {other[0]}/{other[1]} have each other's node id"
        yield Finding("swapped node ids", of, f"{text}: change it with `hyperbit node-id`, or in the file", True)
    moved = {board for pair in boards for board in pair}
    for a, b in swapped.items():
        if a < b and old[a]["output"].board not in moved:
            both = a in whole and any(name in old[a] for name in INPUTS)
            text = (
                f"{a} and {b} are swapped, with outputs and end-stops"
                if both
                else f"the outputs of {a} and {b} are swapped"
            )
            yield Finding("swapped actuators" if both else "swapped outputs", (a, b), text, True)
    for label in old:
        away = old[label]["output"].board in moved
        if outputs[label] and label not in swapped and not away:
            yield output_finding(label, old[label], new[label])
        if inputs[label] and not away and not (label in whole and whole[label] in swapped):
            yield end_stop_finding(label, old, new)


def output_finding(label: str, old: Lines, new: Lines) -> Finding:
    names = [name for name in OUTPUTS if name in old]
    if [place(new[name]) for name in names] == [place(old[name]) for name in names]:
        which = " and ".join(f"`{name}`" for name in names if new[name].inverted != old[name].inverted)
        return Finding("inverted outputs", (label,), f"{which} of {label} is inverted", True)
    if len(names) == 2 and {place(new[name]) for name in names} == {place(old[name]) for name in names}:
        text = f"both outputs of {label} are swapped: it extends where it should contract"
        return Finding("swapped coils", (label,), text, True)
    where = ", ".join(f"`{name}` is {shown(new[name])}" for name in names if new[name] != old[name])
    return Finding("other outputs", (label,), f"other outputs move {label}: {where}", True)


def end_stop_finding(label: str, old: Mapping[str, Lines], new: Mapping[str, Lines]) -> Finding:
    mine = [old[label].get(name) for name in INPUTS]
    found = [new[label].get(name) for name in INPUTS]
    same = [None if a is None else place(a) for a in mine] == [None if b is None else place(b) for b in found]
    if same:
        which = " and ".join(f"`{name}`" for name, a, b in zip(INPUTS, mine, found, strict=True) if a != b)
        return Finding("inverted end-stops", (label,), f"{which} of {label} is inverted", True)
    own = {place(line) for line in mine if line is not None}
    if {place(line) for line in found if line is not None} == own:
        return Finding("crossed end-stops", (label,), f"the end-stops of {label} are at its other end", True)
    others = [
        other
        for other, lines in old.items()
        if other != label and own & {place(line) for name, line in new[other].items() if name in INPUTS} and lines
    ]
    whose = f", and its own are those of {', '.join(others)}" if others else ""
    where = ", ".join(
        f"`{name}` is {shown(line)}" for name, line in zip(INPUTS, found, strict=True) if line is not None
    )
    return Finding(
        "swapped end-stops", (label, *others), f"{label} has other end-stops: {where or 'none'}{whose}", True
    )


def pairs(old: Mapping[str, Lines], new: Mapping[str, Lines], names: tuple[str, ...]) -> Iterator[tuple[str, str]]:
    """Yields each pair of actuators that have each other's lines, in both orders."""
    for a in old:
        for b in old:
            if a != b and exchanged(old[a], new[b], names) and exchanged(old[b], new[a], names):
                yield a, b


def swapped_boards(
    old: Mapping[str, Lines], new: Mapping[str, Lines]
) -> Iterator[tuple[tuple[str, int], tuple[str, int]]]:
    """Yields the boards whose outputs have all become those of the other one, with the same bits."""
    of: dict[tuple[str, int], list[tuple[Terminal, Terminal]]] = {}
    for label, lines in old.items():
        for name in OUTPUTS:
            if name in lines:
                of.setdefault(lines[name].board, []).append((lines[name], new[label][name]))
    boards = list(of)
    for k, one in enumerate(boards):
        for other in boards[k + 1 :]:
            there = all(b.board == other and a.bit == b.bit for a, b in of[one])
            back = all(b.board == one and a.bit == b.bit for a, b in of[other])
            if there and back and len(of[one]) + len(of[other]) > 2:
                yield one, other


def exchanged(old: Lines, new: Lines, names: tuple[str, ...]) -> bool:
    """Returns whether the new lines are those of the old ones, on the same pins."""
    before, after = ([place(of[name]) for name in names if name in of] for of in (old, new))
    return before == after


def differs(old: Lines, new: Lines, names: tuple[str, ...]) -> bool:
    return any(old.get(name) != new.get(name) for name in names)


def place(line: Terminal) -> tuple[str, int, int]:
    return line.bus, line.node, line.bit


def shown(line: Terminal) -> str:
    return f"{line.bus}/{line.node} {line.kind} {line.bit}{', inverted' * line.inverted}"
