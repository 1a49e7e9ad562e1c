"""Which actuators of an arm were commissioned: the record beside the arm's file, which `hyperbit commission` writes."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from msgspec import Struct, field

from hyperbit.controller.armfile.settings import ActuatorSettings, ArmSettings
from hyperbit.controller.armfile.terminals import actuator_terminals
from hyperbit.controller.decoding.decoding import Unreadable, decode
from hyperbit.controller.host.files import read_file


class InputChange(Struct, frozen=True):
    """An input that changed after a command."""

    line: str  # actuator and field, e.g. "5.left.input"
    level: int
    seconds: float  # since the switch


class Sighting(Struct, frozen=True):
    """What a person saw after one command to one actuator, and how the inputs changed."""

    actuator: str
    state: int
    moved: str | None  # actuator that moved; None: nothing did
    to: int = 0  # its new state
    before: dict[str, int] = field(default_factory=dict)  # levels before the switch, by line
    changes: list[InputChange] = field(default_factory=list)
    again: bool = False  # whether the command was tried before
    lamps: tuple[int, int] | None = None  # those of the extending and of the contracting coil afterwards; None: unknown


class CommissionRecord(Struct, frozen=True):
    """What is known of an arm's wiring."""

    arm: str
    commissioned: dict[str, str] = field(default_factory=dict)  # wiring of the actuators that were found right
    wiring: dict[str, str] = field(default_factory=dict)  # wiring by which each actuator was commanded or seen
    sightings: list[Sighting] = field(default_factory=list)


def record_path(file: Path) -> Path:
    """Returns the path of the record of an arm's file."""
    return file.with_name(f"{file.stem}.commission.json")


def wiring_in_words(entry: ActuatorSettings) -> str:
    """Returns the outputs and inputs of an actuator as one text, to compare them."""
    lines = actuator_terminals(entry)
    words = [f"{it.field} {it.bus}/{it.node} {it.bit}{' inverted' * it.inverted}" for it in lines]
    return ", ".join([*words, *([] if entry.pulse is None else [f"pulse {entry.pulse:g}"])])


def warning_of(
    file: Path, settings: ArmSettings, labels: Sequence[str], wired: Sequence[ActuatorSettings]
) -> str | None:
    """Returns a warning that names how many actuators on real boards were never commissioned; None if all were."""
    if not wired or all(bus.interface == "virtual" for bus in settings.buses):
        return None
    path = record_path(file)
    try:
        found = decode(read_file(path), CommissionRecord).commissioned
    except FileNotFoundError:
        found = {}
    except (OSError, Unreadable) as error:
        return f"the record {path.name} cannot be read ({error}): commission the arm again"
    open_ = [label for label, entry in zip(labels, wired, strict=True) if found.get(label) != wiring_in_words(entry)]
    if not open_:
        return None
    who = f"{len(open_)} of {len(labels)} actuators were" if len(open_) > 1 else f"actuator {open_[0]} was"
    return f"{who} never commissioned: nobody has seen which one moves; hyperbit commission {file}"
