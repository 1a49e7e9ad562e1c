"""Travel times from the end-stops of a commission, and the times proposed for the arm's file."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from hyperbit.controller.armfile.commissioned import Sighting
from hyperbit.controller.armfile.settings import ActuatorSettings
from hyperbit.controller.armfile.terminals import actuator_terminals

RESERVE = 1.25  # proposed travel time over the longest measured time
DIFFERENT = 1.5  # an actuator that is faster than the arm's time by this factor gets its own travel time
FIELDS = ("contract", "extend")  # of a travel time in the arm's file, by the state at its end
ENDS = ("input_contracted", "input")

Times = dict[str, dict[int, float]]  # by actuator and the state at the end of the travel [s]


def measured(
    old: Mapping[str, ActuatorSettings], new: Mapping[str, ActuatorSettings], sightings: Sequence[Sighting]
) -> Times:
    """Returns the measured travel times: until the end-stop at the new end has changed.

    `old`: the entries whose names the sightings use. `new`: those that tell to which end each input belongs.
    """
    names: dict[tuple[object, ...], str] = {}
    for label, entry in old.items():
        names |= {it[1:4]: f"{label}.{it.field}" for it in actuator_terminals(entry) if it.kind == "input"}
    times: Times = {label: {} for label in old}
    for seen in sightings:
        if seen.moved is None:
            continue
        ends = {it.field: names[it[1:4]] for it in actuator_terminals(new[seen.moved]) if it.kind == "input"}
        line = ends.get(ENDS[seen.to])
        if (at := next((it.seconds for it in seen.changes if it.line == line), None)) is not None:
            times[seen.moved][seen.to] = at
    return times


def proposed(times: Times) -> tuple[str | None, list[str]]:
    """Returns the travel time for the arm as YAML, None if a direction lacks, and lines on single actuators.

    The arm gets a travel time if all actuators were measured in both directions. An actuator gets its own where the arm
    gets none, or if it is much faster.
    """
    single = {label: {to: reserved(at) for to, at in own.items()} for label, own in times.items()}
    whole = {to: max(own[to] for own in single.values()) for to in (1, 0) if all(to in own for own in single.values())}
    lines = []
    for label, own in single.items():
        faster = len(own) == 2 and all(DIFFERENT * at < whole.get(to, 0.0) for to, at in own.items())
        if faster or own.keys() - whole.keys():
            lines.append(f"{label}: travel_time: {written(own)}")
    return (written(whole) if len(whole) == 2 else None), lines


def reserved(seconds: float) -> float:
    """Returns a measured time with the reserve, rounded up to a millisecond [s]."""
    return math.ceil(round(1000 * RESERVE * seconds, 6)) / 1000


def written(times: Mapping[int, float]) -> str:
    """Returns times as YAML; the time of a direction that was not measured is left open, "..."."""
    shown = (f"{FIELDS[to]}: {times[to]:g}" if to in times else f"{FIELDS[to]}: ..." for to in (1, 0))
    return "{" + ", ".join(shown) + "}"
