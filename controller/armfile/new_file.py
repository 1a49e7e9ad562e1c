"""The text of a new arm's file, and of its table of wiring, from a few answers; the same answers give the same text."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal, NamedTuple

from hyperbit.controller.armfile.actuators import actuator_names, labels
from hyperbit.controller.armfile.documents import parse_yaml
from hyperbit.controller.armfile.module_texts import module_line, parse_module
from hyperbit.controller.armfile.modules import EntrySettings, count_modules, with_group_types
from hyperbit.controller.armfile.settings import ArmSettings
from hyperbit.controller.armfile.strict import InputFaults, check
from hyperbit.controller.armfile.terminals import GREATEST_NODE
from hyperbit.controller.armfile.units import MILLIMETRES, Unit, factors

Valves = Literal["spring", "pair", "pulse"]
EndStops = Literal["none", "extended", "both"]
ErrorStates = Literal["none", "off", "hold", "device"]
Wiring = Literal["rows", "csv"]
VALVES: Mapping[str, str] = {
    "spring": "one output extends; a spring contracts",
    "pair": "two outputs, one for each direction; both off: it stays",
    "pulse": "two outputs with pulses, as of bistable valves",
}
COMMENT = 32  # column of the comments
COLUMNS = ("module", "actuator", "bus", "node", "output", "output_off", "pulse", "input", "input_contracted")
WHERE = "modules"


class Answers(NamedTuple):
    """What a new file is made of."""

    name: str
    modules: tuple[str, ...]  # see module_texts
    unit: Unit = "mm"
    repeat: int = 1  # repetitions of the modules
    tolerance: float | None = None  # in `unit`; None: 2 mm
    travel_time: float = 0.1  # [s]
    valves: Valves = "spring"
    pulse: float = 0.05  # [s]
    end_stops: EndStops = "extended"
    bus: str = "can0"
    bitrate: int = 500_000
    outputs: int = 8  # of a board
    boards: int | None = None  # None: as few as have room
    first_node: int = 1
    island: bool = False
    error_state: ErrorStates = "none"
    wiring: Wiring = "rows"


class NewFile(NamedTuple):
    text: str
    table: str | None  # CSV of the wiring, if it does not stand in the file
    size: str  # modules, actuators and boards in words
    boards: int


def table_name(file: Path) -> str:
    """Returns the name of the table of wiring beside an arm's file."""
    return f"{file.stem}-wiring.csv"


def new_file(answers: Answers, file: Path, command: str) -> NewFile:
    """Returns the texts of a new arm's file and its table.

    Args:
        answers: of the user.
        file: path of the new file; nothing is written.
        command: the command that gives these answers, for the file's first lines.

    Raises:
        ValueError: an answer is wrong; the sentence says what would be right.
    """
    chain = chain_text(answers)
    entries = read_entries(chain, answers.unit)
    faults: list[str] = []
    every = labels(actuator_names(entries, file.parent, faults))
    rows = wiring_rows(answers, every)
    boards = len({row["node"] for row in rows})
    counts = (count_modules(entries), "module"), (len(every), "actuator"), (boards, "board")
    modules, actuators, on_boards = (f"{count} {what}{'s' * (count != 1)}" for count, what in counts)
    size = f"{modules}, {actuators} on {on_boards}"
    text = "\n".join([f"# {size}. Written by", f"#   {command}", *head(answers, chain), *bus_lines(answers, rows)])
    if answers.wiring == "csv":
        text += f"\n\n# Where each actuator is wired, a row each.\nwiring: {table_name(file)}\n"
        return NewFile(text, csv_text(rows), size, boards)
    lines = [f"  - {{{', '.join(f'{key}: {cell}' for key, cell in quoted(row).items())}}}" for row in rows]
    told = "\n\n# Where each actuator is wired. Bits of outputs and inputs count from 0."
    text += "\n".join([told, "actuators:", *lines, ""])
    return NewFile(text, None, size, boards)


def chain_text(answers: Answers) -> str:
    """Returns the section `modules`. Raises ValueError."""
    if not answers.modules:
        raise ValueError("modules: at least one is needed, such as 'prismatic strokes=50 link=60'")
    parsed = [parse_module(text, answers.unit) for text in answers.modules]
    spatial = any(it["kind"] == "stewart" for it in parsed)
    lines = [module_line(it, spatial=spatial) for it in parsed]
    if answers.repeat == 1:
        return "\n".join(["modules:", *(f"  - {line}" for line in lines)])
    count = beside(f"  - count: {answers.repeat}", "repetitions of the modules below")
    return "\n".join(["modules:", count, "    modules:", *(f"      - {line}" for line in lines)])


def read_entries(chain: str, unit: str) -> list[EntrySettings]:
    """Returns the entries of a section `modules`. Raises ValueError if one is wrong."""
    document = with_group_types(parse_yaml(chain, Path(WHERE)))
    faults: list[str] = []
    whole = check({"name": "new", "tolerance": {"position": 1}, **document}, ArmSettings, faults, factors(unit))
    if whole is None:
        raise ValueError("; ".join(faults))
    return whole.modules


def wiring_rows(answers: Answers, every: Sequence[str]) -> list[dict[str, Any]]:
    """Returns a row for each actuator. The actuators are shared evenly among the boards. Raises ValueError."""
    each = 1 if answers.valves == "spring" and not answers.island else 2  # outputs of one place
    room = answers.outputs // each
    if room < 1:
        raise ValueError(f"{answers.outputs} outputs a board, but an actuator needs {each}")
    fewest = -(-len(every) // room)
    boards = fewest if answers.boards is None else answers.boards
    if not fewest <= boards <= len(every):
        needed = f"{len(every)} actuators need {fewest} to {len(every)} boards of {answers.outputs} outputs"
        raise ValueError(f"{boards} boards, but {needed}")
    if answers.first_node + boards - 1 > GREATEST_NODE:
        last = answers.first_node + boards - 1
        raise ValueError(
            f"{boards} boards from node {answers.first_node} end at {last}, but ids end at {GREATEST_NODE}"
        )
    rows = list[dict[str, Any]]()
    for k, label in enumerate(every):
        board = k * boards // len(every)
        place = k - -(-board * len(every) // boards)
        module, _, actuator = label.partition(".")
        node = answers.first_node + board
        row: dict[str, Any] = {"module": int(module), "actuator": actuator, "bus": answers.bus, "node": node}
        row["output"] = each * place
        if answers.valves != "spring":
            row["output_off"] = each * place + 1
        if answers.valves == "pulse":
            row["pulse"] = milliseconds(answers.pulse)
        if answers.end_stops == "extended":
            row["input"] = place
        elif answers.end_stops == "both":
            row |= {"input": 2 * place, "input_contracted": 2 * place + 1}
        rows.append(row)
    return rows


def quoted(row: Mapping[str, Any]) -> dict[str, Any]:
    """Returns a row as YAML has it: names of actuators that are numbers stand in quotes."""
    name = row["actuator"]
    return {**row, "actuator": f'"{name}"' if name.isdecimal() else name, "bus": word(row["bus"])}


def word(text: str) -> str:
    """Returns a name as YAML has it: in quotes if YAML would read it as another value."""
    try:
        plain = parse_yaml(text, Path(WHERE)) == text
    except InputFaults:
        plain = False
    return text if plain else f'"{text}"'


def csv_text(rows: Sequence[Mapping[str, Any]]) -> str:
    columns = [column for column in COLUMNS if column in rows[0]]
    return "\n".join([",".join(columns), *(",".join(str(row[column]) for column in columns) for row in rows)]) + "\n"


def head(answers: Answers, chain: str) -> list[str]:
    """Returns the lines before the buses."""
    tolerance = 2.0 / MILLIMETRES[answers.unit] if answers.tolerance is None else answers.tolerance
    return [
        "# `hyperbit check` names each fault by its line. All fields: controller/manipulator/README.md",
        f"name: {word(answers.name)}",
        beside(f"unit: {answers.unit}", "of all lengths; angles may carry deg, times ms"),
        "",
        "# The chain, base first. A link leads from a module to the next. Measure: a tip is as right as these numbers.",
        chain,
        "",
        beside(f"tolerance: {{position: {tolerance:.4g}}}", "greatest distance of the tip from a goal"),
        beside(f"travel_time: {milliseconds(answers.travel_time)}", "longest time of an actuator from end to end"),
        beside("#inrush: 4", "most actuators that switch at once"),
        "",
    ]


def bus_lines(answers: Answers, rows: Sequence[Mapping[str, Any]]) -> list[str]:
    """Returns the lines of buses and boards."""
    on_loss = "contract" if answers.error_state == "off" and answers.valves == "spring" else "hold"
    bus = word(answers.bus)
    lines = [
        "buses:",
        f"  - {{name: {bus}, channel: {bus}, interface: socketcan, bitrate: {answers.bitrate}}}",
        "",
        "boards:",
        beside(f"  on_loss: {on_loss}", "what the actuators do when the boards lose the executor"),
    ]
    if answers.error_state != "none":
        lines.append(beside(f'  error_state: "{answers.error_state}"', "what boards without 6206h and 6207h do then"))
    if answers.island:
        nodes = dict.fromkeys(row["node"] for row in rows)
        lines += ["  nodes:", *(f"    - {{bus: {bus}, node: {node}, island: true}}" for node in nodes)]
        supply = f"{{bus: {bus}, node: {answers.first_node}, object: 0x2102, sub: 0, bit: 0}}"
        lines += ["", "# A bit that is 1 while the valves have their supply, as the manual of the island names it:"]
        lines += [f"#interlocks: {{supply: {supply}}}"]
    return lines


def beside(text: str, comment: str) -> str:
    return f"{text:<{COMMENT - 1}} # {comment}"


def milliseconds(time: float) -> str:
    return f"{time * 1e3:.10g} ms"
