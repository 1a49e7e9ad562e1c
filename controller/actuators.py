"""The actuators of an arm's file: their labels in order, and where each is wired; no geometry."""

import csv
from collections.abc import Sequence
from itertools import islice
from pathlib import Path, PurePath

from controller.settings import (
    ActuatorSettings,
    ArmSettings,
    ModuleSettings,
    PlatformSettings,
    PrismaticSettings,
    RevoluteSettings,
    TransformsSettings,
    VgtSettings,
    read_settings,
)
from controller.strict import InputFaults

VGT: tuple[str, ...] = ("left", "diagonal", "right")  # of a truss module
MOST_ROWS = 4096  # of a table


def read_wired(path: Path) -> tuple[ArmSettings, tuple[str, ...], tuple[ActuatorSettings, ...]]:
    """Reads the parts of an arm's file that the executor needs.

    Returns:
        The file's fields, the label of each actuator in order, and where each is wired.

    Raises:
        InputFaults: the file is missing or wrong in these parts, or maps no actuator; geometry is not checked.
    """
    settings, faults = read_settings(path)
    modules = actuator_names(settings.modules, path.parent, faults)
    wiring = () if faults else map_actuators(settings, modules, faults)
    if not faults and not wiring:
        faults.append("actuators: none is mapped to a board, so there is nothing to run")
    if faults:
        raise InputFaults(path, faults)
    return settings, labels(modules), wiring


def labels(modules: Sequence[Sequence[str]]) -> tuple[str, ...]:
    """Returns "<module>.<name>" of each actuator, modules counted from 1: the order of all state vectors."""
    return tuple(f"{i + 1}.{name}" for i, names in enumerate(modules) for name in names)


def actuator_names(groups: Sequence[ModuleSettings], folder: Path, faults: list[str]) -> list[tuple[str, ...]]:
    """Returns the names of the actuators of each module, base first.

    Args:
        groups: the file's `modules`.
        folder: where tables are looked for.
        faults: appended to.
    """
    modules: list[tuple[str, ...]] = []
    for g, group in enumerate(groups):
        match group:
            case VgtSettings():
                names = VGT
            case RevoluteSettings():
                names = numbered(code_length(len(group.angles)))
            case PrismaticSettings():
                names = numbered(code_length(len(group.lengths)))
            case PlatformSettings():
                names = numbered(len(group.base))
            case TransformsSettings():
                states = len(group.states or []) or count_rows(folder, group.table, f"modules[{g}].table", faults)
                names = numbered(code_length(states))
        modules += [names] * group.count
    return modules


def numbered(count: int) -> tuple[str, ...]:
    """Returns the names "1", "2", ... of so many actuators."""
    return tuple(str(k + 1) for k in range(count))


def code_length(states: int) -> int:
    """Returns how many binary digits tell so many states apart."""
    return max(states - 1, 0).bit_length()


def count_rows(folder: Path, name: str | None, path: str, faults: list[str]) -> int:
    """Returns the number of states in a table, a CSV file with one state a row; its numbers are not checked."""
    if name is None or PurePath(name).is_absolute() or ".." in PurePath(name).parts or not name.endswith(".csv"):
        faults.append(f"{path}: a CSV file beside the arm's is needed, such as measured.csv, got {name!r}")
        return 0
    try:
        with (folder / name).open(newline="", encoding="utf-8-sig") as file:
            reader = csv.reader(file, skipinitialspace=True, strict=True)
            next(reader, None)
            rows = sum(1 for row in islice(reader, MOST_ROWS + 1) if row)
    except (OSError, ValueError, csv.Error) as error:
        reason = error.strerror if isinstance(error, OSError) else error
        faults.append(f"{path}: {name} cannot be read: {reason}")
        return 0
    if not 2 <= rows <= MOST_ROWS:
        faults.append(f"{path}: {name}: 2 to {MOST_ROWS} rows are needed, a state each, got {rows}")
    return rows


def map_actuators(
    settings: ArmSettings, modules: Sequence[Sequence[str]], faults: list[str]
) -> tuple[ActuatorSettings, ...]:
    """Returns where each actuator is wired, in the order of `labels`; those that are not mapped are left out.

    Args:
        settings: of the arm.
        modules: names of the actuators of each module, base first.
        faults: appended to.
    """
    buses = [bus.name for bus in settings.buses]
    faults += [f"buses[{k}].name: {b!r} is already taken" for k, b in enumerate(buses) if b in buses[:k]]
    found: dict[str, ActuatorSettings] = {}
    taken: dict[tuple[str, str, int, int], str] = {}
    for k, entry in enumerate(settings.actuators):
        path, label = f"actuators[{k}]", f"{entry.module}.{entry.actuator}"
        if entry.module > len(modules):
            faults.append(f"{path}.module: {entry.module}, but the arm has modules 1 to {len(modules)}")
        elif entry.actuator not in modules[entry.module - 1]:
            names = ", ".join(modules[entry.module - 1])
            faults.append(f"{path}.actuator: {entry.actuator!r}, but module {entry.module} has {names}")
        elif label in found:
            faults.append(f"{path}: actuator {label} is mapped already")
        else:
            found[label] = entry
        if entry.bus not in buses:
            faults.append(f"{path}.bus: {entry.bus!r} is none of the buses {', '.join(buses) or '(none)'}")
        for kind, bit in (("output", entry.output), ("input", entry.input)):
            if bit is None:
                continue
            where = (kind, entry.bus, entry.node, bit)
            if where in taken:
                faults.append(f"{path}.{kind}: {kind} {bit} of {entry.bus}/{entry.node} is {taken[where]}'s already")
            taken.setdefault(where, label)
    every = labels(modules)
    if settings.actuators or settings.buses:
        faults += [f"actuators: {label} is not mapped" for label in every if label not in found]
    return tuple(found[label] for label in every if label in found)
