"""The words of the executor's scenarios: states, and arms that differ from the small one.

States are A, B, C, ALL or binary numbers; "10/1": extending and contracting outputs, or ends. Times are in seconds.
"""

from __future__ import annotations

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


def states_of(word: str) -> int:
    extending, _, contracting = word.partition("/")
    named = {"A": A, "B": B, "C": C, "ALL": ALL}
    return (named[extending] if extending in named else int(extending, 2)) | int(contracting or "0", 2) << SIZE


def fields_of(settings: list[str]) -> dict[str, Any]:
    """Returns the fields of an arm that is described in words."""
    fields: dict[str, Any] = {}
    for part in settings:
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
