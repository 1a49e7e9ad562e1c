"""Each fault of wiring on each kind of actuator: found by its name, and the proposal is the wiring of the boards."""

from __future__ import annotations

import copy
from collections.abc import Callable
from pathlib import Path

import pytest
from msgspec import to_builtins

from tests.commission.rig import ENDS, LABELS, OUTPUTS, Entry, commissioned, entries

Wiring = dict[str, Entry]


def swap(truth: Wiring, a: str, b: str, *fields: str) -> None:
    for field in fields:
        truth[a][field], truth[b][field] = truth[b].get(field), truth[a].get(field)


def invert(truth: Wiring, label: str, *fields: str) -> None:
    for field in fields:
        if truth[label].get(field) is not None:
            truth[label][field] = {"bit": truth[label][field], "inverted": True}


def cross(truth: Wiring, label: str, one: str, other: str) -> None:
    entry = truth[label]
    entry[one], entry[other] = entry.get(other), entry.get(one)


def renumber(truth: Wiring) -> None:
    for entry in truth.values():
        entry["node"] = 3 - entry["node"]


FAULTS: dict[str, tuple[Callable[[Wiring], None], str]] = {
    "no fault": (lambda truth: None, ""),
    "swapped outputs": (lambda truth: swap(truth, "1.1", "1.2", "output", "output_off"), "swapped outputs"),
    "swapped outputs of two boards": (
        lambda truth: swap(truth, "1.1", "2.2", "output", "output_off", "node"),
        "swapped outputs",
    ),
    "swapped actuators": (
        lambda truth: swap(truth, "1.1", "1.2", "output", "output_off", "input", "input_contracted"),
        "swapped actuators",
    ),
    "swapped node ids": (renumber, "swapped node ids"),
    "inverted outputs": (lambda truth: invert(truth, "1.2", "output", "output_off"), "inverted outputs"),
    "one inverted output": (lambda truth: invert(truth, "1.2", "output_off"), "inverted outputs"),
    "swapped coils": (lambda truth: cross(truth, "1.2", "output", "output_off"), "swapped coils"),
    "dead output": (lambda truth: truth["2.1"].update(output=5), "dead"),
    "inverted end-stops": (lambda truth: invert(truth, "1.2", "input", "input_contracted"), "inverted end-stops"),
    "crossed end-stops": (lambda truth: cross(truth, "1.2", "input", "input_contracted"), "crossed end-stops"),
    "swapped end-stops": (
        lambda truth: swap(truth, "1.1", "1.2", "input", "input_contracted"),
        "swapped end-stops",
    ),
    "dead end-stops": (lambda truth: truth["2.1"].update(input=None, input_contracted=None), "dead end-stop"),
}
PAIRS_ONLY = {"one inverted output", "swapped coils"}


def cases() -> list[tuple[str, str, str]]:
    """Returns outputs, end-stops and fault of each arm on which this fault can be made."""
    return [
        (outputs, ends, fault)
        for outputs in OUTPUTS
        for ends in ENDS
        for fault in FAULTS
        if not (fault in PAIRS_ONLY and outputs == "one output") and not ("end-stop" in fault and ends == "no end")
    ]


@pytest.mark.parametrize(("outputs", "ends", "fault"), cases())
def test_a_fault_is_found_and_proposed(tmp_path: Path, outputs: str, ends: str, fault: str) -> None:
    file = entries(outputs, ends)
    truth = copy.deepcopy(file)
    make, kind = FAULTS[fault]
    make(truth)
    if fault == "swapped outputs of two boards":  # the end-stops stay on their boards
        for label, board in (("1.1", 1), ("2.2", 2)):
            truth[label] |= {field: {"bit": file[label][field], "board": f"can0/{board}"} for field in ENDS[ends]}
    truth = {label: {k: v for k, v in entry.items() if v is not None} for label, entry in truth.items()}
    found = commissioned(tmp_path, file, truth).diagnosis
    kinds = {finding.kind for finding in found.findings}
    if fault == "swapped actuators" and ends == "no end":
        kind = "swapped outputs"
    if outputs == "pair" and fault == "inverted outputs":
        kind = "swapped coils"  # both drive the coils the same way
        truth = copy.deepcopy(file)
        cross(truth, "1.2", "output", "output_off")
    assert kinds == ({kind} if kind else set()), found.findings
    if "dead" in kind:
        assert found.right == [label for label in LABELS if label != "2.1"]
        return
    told = {label: plain(to_builtins(entry)) for label, entry in found.entries.items()}
    assert told == {label: plain(entry) for label, entry in truth.items()}
    if not kind:
        assert found.right == list(LABELS)


def plain(entry: Entry) -> Entry:
    """Returns the outputs and inputs of an entry, each as bit, inverted and board."""
    lines = {name: entry.get(name) for name in ("output", "output_off", "input", "input_contracted")}
    default = {"inverted": False, "board": None}
    shown = {
        name: {**default, **(line if isinstance(line, dict) else {"bit": line})}
        for name, line in lines.items()
        if line is not None
    }
    return {"node": entry["node"], **shown}
