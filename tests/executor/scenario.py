"""The language of scenarios: a title, the arms that it is played on, and steps, each with what is seen after it.

    a stop stays until reset
      with rest 0.3               one line for each arm; none: the small arm as it is
      stop                        -> stopped
      run A                       -> declined arm-stopped
      reset                       -> starting | answer resetting...
      wait 0.02                   -> ready

After each step these are as told, and where nothing is told they have not changed: the mode, commanded states, results,
declined programs, and whether the executor has ended. Other facts are compared where they are told. "..." is any text.
States are A, B, C, ALL or binary numbers; "10/1": extending and contracting outputs, or ends. Times are in seconds.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from hyperbit.drivers.canopen.wiring import BoardId, Interlock, NodeWiring, WatchedObject
from tests.executor.rig import ALL, SIZE, TRAVEL, A, B, C

CHANNELS = {
    "two outputs": {"output_off": True},
    "pulses": {"output_off": True, "pulse": 0.05},
    "long pulses": {"output_off": True, "pulse": 4 * TRAVEL},
    "second long pulses": {"output_off": True, "pulse": 1.0},
    "both ends": {"input_contracted": True},
    "inverted ends": {"inverted": frozenset({"input", "input_contracted"})},
    "inverted outputs": {"inverted": frozenset({"output"})},
}
INTERLOCKS = {
    "stop": Interlock("stop", "can0", 9, 0),
    "air": Interlock("air", "can0", 9, 1),
    "door": Interlock("door", "can0", 9, 5, inverted=True),
    "supply": Interlock("supply", "can0", 9, 0, watched=WatchedObject(0x2102, 0)),
}


@dataclass
class Line:
    number: int
    step: str
    seen: list[str]


@dataclass
class Scenario:
    title: str
    arm: list[str]  # what differs from the small arm
    lines: list[Line] = field(default_factory=list)


def read(path: Path) -> Iterator[Scenario]:
    """Yields each scenario of a file, once for each of its arms."""
    scenario, arms = None, list[str]()
    for number, row in enumerate([*path.read_text().splitlines(), "the end"], 1):
        step, _, seen = map(str.strip, row.partition("->"))
        parts = [part.strip() for part in seen.split(" | ") if part.strip()]
        if row.startswith("#"):
            continue
        if row[:1].strip():  # a title
            if scenario is not None:
                for arm in arms or [""]:
                    yield Scenario(scenario.title, [part.strip() for part in arm.split(";") if part], scenario.lines)
            scenario, arms = Scenario(step, []), []
        elif scenario is not None and step.startswith("with "):
            arms.append(step.removeprefix("with "))
        elif scenario is not None and step:
            scenario.lines.append(Line(number, step, parts))
        elif scenario is not None:
            scenario.lines[-1].seen += parts


def states_of(word: str) -> int:
    extending, _, contracting = word.partition("/")
    named = {"A": A, "B": B, "C": C, "ALL": ALL}
    return (named[extending] if extending in named else int(extending, 2)) | int(contracting or "0", 2) << SIZE


def fields_of(arm: list[str]) -> dict[str, Any]:
    """Returns the fields of an arm that is described in words."""
    fields: dict[str, Any] = {}
    for part in arm:
        name, *values = part.split()
        if part in CHANNELS:
            fields["channel"] = {**fields.get("channel", {}), **CHANNELS[part]}
        elif name == "travel":
            fields.setdefault("channel", {})["travel"] = tuple(map(float, values))
        elif name in ("sensed", "locked", "locked_states"):
            fields[name] = states_of(values[0])
        elif name == "interlocks":
            fields["interlocks"] = tuple(INTERLOCKS[value] for value in values)
        elif name == "unverified":
            fields["nodes"] = (NodeWiring("can0", 1, verify=False),)
        elif name == "ends":  # on a board of their own
            bus, node = values[-1].split("/")
            fields["input_board"] = BoardId(bus, int(node))
        elif part != "from the start":
            fields[name] = (int if name == "inrush" else float if values[0][0].isdigit() else str)(values[0])
            fields[name] = {"yes": True}.get(values[0], fields[name])
    return fields
