"""A summary of an arm: its parts and its reach."""

import math
from collections import Counter
from typing import Any

from hyperbit.controller.arm.arm import Arm
from hyperbit.controller.armfile.modules import places
from hyperbit.controller.armfile.names import shortened
from hyperbit.controller.armfile.terminals import named_boards
from hyperbit.controller.armfile.units import unit_mark, unit_name
from hyperbit.controller.workspace.hull import build_hull


def summarize(arm: Arm) -> dict[str, Any]:
    """Returns the fields of `hyperbit check --json` that describe an arm.

    `modules` has the number of modules by type, `boards` the number of boards by bus. `log2_configurations` is the
    binary logarithm of the number of configurations. Lengths are in `unit`, the arm's, times in seconds.
    """
    settings, manipulator = arm.settings, arm.manipulator
    modules = Counter[str]()
    for entry in places(settings.modules):
        modules[str(type(entry.settings).__struct_config__.tag)] += 1
    boards = Counter(bus for bus, _ in named_boards(settings))
    return {
        "name": settings.name,
        "dimension": manipulator.dimension,
        "modules": dict(modules),
        "actuators": len(manipulator.actuators),
        "log2_configurations": math.fsum(math.log2(states) for states in manipulator.states.tolist()),
        "boards": {bus.name: boards[bus.name] for bus in settings.buses},
        "two_outputs": [f"{each.module}.{each.actuator}" for each in settings.actuators if each.output_off is not None],
        "pulsed": [f"{each.module}.{each.actuator}" for each in settings.actuators if each.pulse is not None],
        "interlocks": list(settings.interlocks),
        "unit": settings.unit,
        "length": manipulator.length,
        "reach": min(build_hull(manipulator).reach, manipulator.length),
        "travel_time": arm.travel_time,
    }


def summary_lines(fields: dict[str, Any]) -> list[tuple[str, str]]:
    """Returns a summary in words: pairs of label and value."""
    modules = ", ".join(f"{count} {kind}" for kind, count in fields["modules"].items())
    buses = ", ".join(f"{count} on {bus}" for bus, count in fields["boards"].items())
    digits, mark = fields["log2_configurations"], unit_mark(fields["unit"])
    wired = (("two outputs", "two_outputs"), ("pulsed", "pulsed"), ("interlocks", "interlocks"))
    return [
        ("modules", modules),
        ("actuators", str(fields["actuators"])),
        ("configurations", f"2^{digits:.0f}" if digits == round(digits) else f"2^{digits:.1f}"),
        ("boards", buses or "none"),
        *((what, shortened(fields[name])) for what, name in wired if fields[name]),
        *([("lengths", f"in the {unit_name(None)}")] if fields["unit"] is None else []),
        ("length", f"{fields['length']:.4g}{mark}"),
        ("reach", f"{fields['reach']:.4g}{mark} from the base"),
        ("travel time", f"{fields['travel_time']:g} s"),
    ]
