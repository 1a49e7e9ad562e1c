"""What is wired wrongly: from what was seen after each command to the wiring that explains it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import product
from typing import NamedTuple

from msgspec.structs import replace

from hyperbit.controller.armfile.commissioned import Sighting
from hyperbit.controller.armfile.locks import STATES
from hyperbit.controller.armfile.settings import ActuatorSettings, BitSettings, InputSettings
from hyperbit.controller.armfile.terminals import Terminal, actuator_terminals
from hyperbit.controller.commission.end_stops import find_end_stops
from hyperbit.controller.commission.findings import Finding, Lines, compared, place

Latest = Mapping[tuple[str, int], Sighting]  # the last sighting of each actuator and commanded state


class Diagnosis(NamedTuple):
    """What sightings tell of the wiring.

    Attributes:
        findings: its faults.
        entries: the wiring that explains what was seen, by actuator.
        right: actuators that were seen to follow both commands, with end-stops that agree.
    """

    findings: list[Finding]
    entries: dict[str, ActuatorSettings]
    right: list[str]


def diagnose(entries: Mapping[str, ActuatorSettings], sightings: Sequence[Sighting]) -> Diagnosis:
    """Returns what the sightings tell of the wiring of an arm's file, given by actuator."""
    latest = {(one.actuator, one.state): one for one in sightings if one.actuator in entries}
    old: dict[str, Lines] = {k: {line.field: line for line in actuator_terminals(e)} for k, e in entries.items()}
    findings: list[Finding] = []
    pulsed = {label for label, entry in entries.items() if entry.pulse is not None}
    outputs = find_outputs(old, latest, pulsed, findings)
    ends = find_end_stops(old, list(latest.values()), findings)
    found = {label: rewired(entry, outputs[label] | ends[label]) for label, entry in entries.items()}
    new = {label: outputs[label] | ends[label] for label in entries}
    findings += compared(old, new)
    wrong = {label for finding in findings for label in finding.actuators}
    tried = [label for label in entries if all((label, state) in latest for state in (0, 1))]
    return Diagnosis(findings, found, [label for label in tried if label not in wrong and new[label] == old[label]])


def find_outputs(
    old: Mapping[str, Lines], latest: Latest, pulsed: set[str], findings: list[Finding]
) -> dict[str, Lines]:
    """Returns the outputs of each actuator by field: those that were seen to move it, else those of the file."""
    drives: dict[str, Lines] = {label: {} for label in old}
    for (label, state), seen in latest.items():
        if seen.moved is None:
            continue
        paired = "output_off" in old[label]
        if paired != ("output_off" in old[seen.moved]):
            kinds = ("one output", "two outputs") if paired else ("two outputs", "one output")
            text = f"{label}, which has {kinds[1]}, moves {seen.moved}, which has {kinds[0]}: look at the wires"
            findings.append(Finding("kind", (label, seen.moved), text, False))
            continue
        if paired:
            line = old[label]["output" if state else "output_off"]._replace(field="output" if seen.to else "output_off")
        else:
            line = old[label]["output"]
            line = line._replace(inverted=line.inverted != (state != seen.to))
        before = drives[seen.moved].setdefault(line.field, line)
        if before != line:
            text = f"{seen.moved} followed two outputs, {shown(before)} and {shown(line)}: try them again"
            findings.append(Finding("contradiction", (seen.moved,), text, False))
    for label, lines in old.items():
        if "output_off" in lines:
            drives[label] |= inverted_by_lamps(label, lines, latest, label in pulsed)
        find_dead(label, lines, latest, drives[label], findings)
    return completed(old, drives)


def inverted_by_lamps(label: str, lines: Lines, latest: Latest, pulsed: bool) -> Lines:
    """Returns the outputs of a pair that are inverted, by the lamps of its valve; none if the lamps do not tell.

    The lamps count after commands that moved nothing, or moved it backwards. A pair without pulses that moves backwards
    has swapped outputs, or two inverted ones: both drive its coils the same way.
    """
    seen = [one for state in (0, 1) if (one := latest.get((label, state))) is not None]
    still = all(one.moved is None for one in seen)
    backwards = all(one.moved == label and one.to != one.state for one in seen)
    if not seen or any(one.lamps is None for one in seen) or not (still or (backwards and pulsed)):
        return {}
    fits = []
    for on, off in product((False, True), repeat=2):
        levels = [(0, 0) if pulsed else (one.state, 1 - one.state) for one in seen]
        if all(one.lamps == (a ^ on, b ^ off) for one, (a, b) in zip(seen, levels, strict=True)):
            fits.append({"output": on, "output_off": off})
    if len(fits) != 1 or not any(fits[0].values()):
        return {}
    return {name: lines[name]._replace(inverted=lines[name].inverted != wrong) for name, wrong in fits[0].items()}


def find_dead(label: str, lines: Lines, latest: Latest, drives: Lines, findings: list[Finding]) -> None:
    """Appends what moved nothing, unless inverted outputs explain it."""
    still = [state for state in (0, 1) if (one := latest.get((label, state))) is not None and one.moved is None]
    if not still or (len(still) == 2 and len(drives) == 2):
        return
    names = ["output" if state or "output_off" not in lines else "output_off" for state in still]
    where = " and ".join(dict.fromkeys(shown(lines[name]) for name in names))
    lit = [one.lamps for state in still if (one := latest[label, state]).lamps is not None]
    if lit and all(lamps == (0, 0) for lamps in lit):
        cause = "no lamp at its valve was lit: check output, wire, supply and fuse"
    else:
        cause = "check air or power, valve, wire and fuse"
    how = " or ".join(STATES[state] for state in still)
    findings.append(Finding("dead", (label,), f"{label} did not become {how} by {where}: {cause}", False))


def completed(old: Mapping[str, Lines], drives: Mapping[str, Lines]) -> dict[str, Lines]:
    """Returns all outputs of each actuator: those seen, then its own, then those that are left over, in their order."""
    taken = {place(line) for lines in drives.values() for line in lines.values()}
    every = [line for lines in old.values() for line in lines.values() if line.kind == "output"]
    left = [line for line in every if place(line) not in taken]
    made: dict[str, Lines] = {}
    for label, lines in old.items():
        made[label] = {}
        for name in (name for name in ("output", "output_off") if name in lines):
            line = drives[label].get(name)
            if line is None and place(lines[name]) not in taken:
                line = lines[name]
            if line is None:  # its own output moves another actuator; the board of its other output has to fit
                boards = {other.board for other in drives[label].values()}
                fitting = [one for one in left if not boards or one.board in boards] or left
                line = fitting[0]._replace(field=name)
            left = [one for one in left if place(one) != place(line)]
            made[label][name] = line
    return made


def rewired(entry: ActuatorSettings, lines: Lines) -> ActuatorSettings:
    """Returns the entry of an actuator with other outputs and inputs."""
    bus, node = lines["output"].board
    own: dict[str, object] = {"bus": bus, "node": node}
    for name in ("output", "output_off", "input", "input_contracted"):
        line = lines.get(name)
        if line is None:
            own[name] = None
        elif line.kind == "input" and line.board != (bus, node):
            own[name] = InputSettings(line.bit, line.inverted, f"{line.bus}/{line.node}")
        else:
            own[name] = BitSettings(line.bit, True) if line.inverted else line.bit
    return replace(entry, **own)


def shown(line: Terminal) -> str:
    return f"{line.bus}/{line.node} output {line.bit}"
