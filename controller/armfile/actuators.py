"""The actuators of an arm's file: their labels, in order, and their wiring; no geometry."""

from collections.abc import Sequence
from pathlib import Path

from hyperbit.controller.armfile.csv_files import check_states, read_states
from hyperbit.controller.armfile.error_states import check_error_states
from hyperbit.controller.armfile.modules import (
    ChainEntry,
    EntrySettings,
    PlatformSettings,
    PrismaticSettings,
    RevoluteSettings,
    TransformsSettings,
    VgtSettings,
    chain,
    places,
)
from hyperbit.controller.armfile.places import counted, placed_faults
from hyperbit.controller.armfile.settings import ActuatorSettings, ArmSettings, TravelSettings, read_settings
from hyperbit.controller.armfile.strict import InputFaults
from hyperbit.controller.armfile.terminals import check_terminals, named_boards, no_bus

VGT: tuple[str, ...] = ("left", "diagonal", "right")  # of a truss module
STAGE = 0.1  # [s] for a stage beside the travel time, its margin and the rest


def read_wired(path: Path) -> tuple[ArmSettings, tuple[str, ...], tuple[ActuatorSettings, ...]]:
    """Reads the parts of an arm's file that the executor needs.

    Returns:
        The file's fields, the label of each actuator in order, and the wiring of each.

    Raises:
        InputFaults: the file is missing or wrong in these parts, or maps no actuator; geometry is not checked.
    """
    with placed_faults(path):
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


def actuator_names(entries: Sequence[EntrySettings], folder: Path, faults: list[str]) -> list[tuple[str, ...]]:
    """Returns the names of the actuators of each module, base first.

    Args:
        entries: the file's `modules`.
        folder: where tables are looked for.
        faults: appended to.
    """
    modules: list[tuple[str, ...]] = []
    known: dict[str, tuple[str, ...]] = {}  # by the path of the entry
    for path, _, group in chain(entries):
        if path in known:
            modules += [known[path]] * group.count
            continue
        match group:
            case VgtSettings():
                names = VGT
            case RevoluteSettings(cylinders=[*cylinders]) | PrismaticSettings(cylinders=[*cylinders]):
                names = numbered(len(cylinders))
            case RevoluteSettings():
                names = numbered(code_length(len(group.angles or ())))
            case PrismaticSettings():
                names = numbered(code_length(len(group.lengths or ())))
            case PlatformSettings():
                names = numbered(len(group.base))
            case TransformsSettings():
                states = len(group.states or []) or count_rows(folder, group.table, f"{path}.table", faults)
                names = numbered(code_length(states))
        known[path] = names
        modules += [names] * group.count
    return modules


def numbered(count: int) -> tuple[str, ...]:
    """Returns the names "1", "2", ... of `count` actuators."""
    return tuple(str(k + 1) for k in range(count))


def code_length(states: int) -> int:
    """Returns the number of binary digits that distinguish `states` states."""
    return max(states - 1, 0).bit_length()


def count_rows(folder: Path, name: str | None, path: str, faults: list[str]) -> int:
    """Returns the number of states in a table, a CSV file with one state a row; the numbers are not checked."""
    table = read_states(folder, name, path, faults)
    if table is None:
        return 0
    check_states(table, name, path, faults)
    return len(table.rows)


def map_actuators(
    settings: ArmSettings, modules: Sequence[Sequence[str]], faults: list[str]
) -> tuple[ActuatorSettings, ...]:
    """Returns the wiring of each actuator, in the order of `labels`; actuators without wiring are omitted.

    Args:
        settings: of the arm.
        modules: names of the actuators of each module, base first.
        faults: appended to.
    """
    buses = [bus.name for bus in settings.buses]
    faults += [f"buses[{k}].name: {b!r} is already taken" for k, b in enumerate(buses) if b in buses[:k]]
    channels = [(bus.interface, bus.channel) for bus in settings.buses]
    faults += [
        f"buses[{k}].channel: {place[1]!r} is the channel of {buses[channels.index(place)]}; each bus needs its own"
        for k, place in enumerate(channels)
        if place in channels[:k]
    ]
    found: dict[str, ActuatorSettings] = {}
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
    check_terminals(settings, faults)
    check_kinds(settings, faults)
    check_error_states(settings, faults)
    check_nodes(settings, buses, faults)
    every = labels(modules)
    if settings.actuators or settings.buses:
        where = places(settings.modules)
        faults += [f"actuators: {label} is not mapped{of_group(where, label)}" for label in every if label not in found]
    return tuple(found[label] for label in every if label in found)


def of_group(where: Sequence[ChainEntry], label: str) -> str:
    """Returns entry and repetition of an actuator in a group, for a sentence; "" outside of groups."""
    entry = where[int(label.partition(".")[0]) - 1]
    return f" ({counted(entry.place)})" if entry.repetition else ""


def travel_times(settings: ArmSettings, entry: ActuatorSettings) -> tuple[float, float]:
    """Returns the longest times of an actuator to its contracted and to its extended end [s]."""
    times = settings.travel_time if entry.travel_time is None else entry.travel_time
    return (times.contract, times.extend) if isinstance(times, TravelSettings) else (times, times)


def longest_travel(settings: ArmSettings) -> float:
    """Returns the longest time of any actuator from end to end [s]."""
    given = [entry.travel_time for entry in settings.actuators]
    every = [settings.travel_time if times is None else times for times in given] or [settings.travel_time]
    return max(max(times.extend, times.contract) if isinstance(times, TravelSettings) else times for times in every)


def ending_time(settings: ArmSettings, actuators: int) -> float:
    """Returns the longest time in which an arm contracts before the executor ends [s]; 0 if it holds.

    Each stage travels, may be found late, and rests. Actuators of unknown state may need as many stages again.
    """
    if settings.on_stop == "hold":
        return 0.0
    stages = 2 * -(-actuators // (settings.inrush or actuators)) + 1
    margin = max([entry.settle_margin or 0.0 for entry in settings.actuators] + [settings.boards.settle_margin])
    return stages * (longest_travel(settings) + margin + settings.rest_time + STAGE)


def check_kinds(settings: ArmSettings, faults: list[str]) -> None:
    """Appends the faults of fields that an actuator's kind does not allow."""
    boards = settings.boards
    for k, entry in enumerate(settings.actuators):
        path, on_loss = f"actuators[{k}]", entry.on_loss or boards.on_loss
        field = "boards.on_loss" if entry.on_loss is None else f"{path}.on_loss"
        if entry.pulse is not None and entry.output_off is None:
            faults.append(
                f"{path}.pulse: {entry.pulse:g} s, but an actuator without `output_off` returns when its output goes"
                " off; a bistable one needs both outputs, any other no pulse"
            )
        if entry.pulse is not None and on_loss == "contract":
            faults.append(
                f"{field}: contract, but the outputs of actuator {entry.module}.{entry.actuator} are off between"
                " pulses, so it stays where it is; this actuator needs its own on_loss: hold"
            )


def check_nodes(settings: ArmSettings, buses: Sequence[str], faults: list[str]) -> None:
    """Appends the faults of the entries on single boards."""
    wired = named_boards(settings)
    seen: set[tuple[str, int]] = set()
    if settings.boards.error_state is True:
        faults.append("boards.error_state: true, but off, hold or device is needed")
    for k, node in enumerate(settings.boards.nodes):
        path, place = f"boards.nodes[{k}]", (node.bus, node.node)
        if node.bus not in buses:
            faults.append(f"{path}.bus: {no_bus(node.bus, buses)}")
        elif place in seen:
            faults.append(f"{path}: board {node.bus}/{node.node} is there already; one entry a board is needed")
        elif place not in wired:
            faults.append(f"{path}.node: board {node.bus}/{node.node} has no output, end-stop or interlock")
        if 0x5FFF < node.object < 0x6200:
            faults.append(f"{path}.object: {node.object:#x}, but 0x6200 or an object from 0x2000 to 0x5fff is needed")
        if node.error_state is True:
            faults.append(f"{path}.error_state: true, but off, hold or device is needed")
        seen.add(place)
