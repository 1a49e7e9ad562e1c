"""The command `new`: writes a new arm's file from options and questions."""

from __future__ import annotations

import shlex
import sys
import tempfile
from pathlib import Path
from typing import Annotated

import typer

from hyperbit.controller.armfile.new_file import Answers, NewFile, new_file, table_name
from hyperbit.controller.armfile.strict import InputFaults
from hyperbit.controller.commands import common
from hyperbit.controller.commands.common import CommandFailed
from hyperbit.controller.commands.configure.check import checked_arm
from hyperbit.controller.commands.configure.new_questions import collected

Text = str | None


def new(
    file: Annotated[Path, typer.Argument(metavar="ARM.yaml", help="The file to write.", show_default=False)],
    module: Annotated[
        list[str] | None,
        typer.Option(metavar="TEXT", help="Module, such as 'prismatic strokes=25,50 link=60'; repeatable, base first."),
    ] = None,
    repeat: Annotated[Text, typer.Option(help="Repetitions of these modules, as a group.")] = None,
    arm_name: Annotated[Text, typer.Option("--name", help="Name of the arm. Default: that of the file.")] = None,
    unit: Annotated[Text, typer.Option(help="Unit of all lengths: m, cm, mm, in.")] = None,
    tolerance: Annotated[Text, typer.Option(help="Greatest distance of the tip from a goal.")] = None,
    travel_time: Annotated[Text, typer.Option(help="Longest time from end to end, such as '100 ms'.")] = None,
    valves: Annotated[Text, typer.Option(help="spring, pair or pulse: outputs of an actuator.")] = None,
    pulse: Annotated[Text, typer.Option(help="Length of a pulse, such as '50 ms'.")] = None,
    end_stops: Annotated[Text, typer.Option(help="none, extended or both.")] = None,
    bus: Annotated[Text, typer.Option(help="CAN interface.")] = None,
    bitrate: Annotated[Text, typer.Option(help="Bit rate of the bus, such as '500 kbit/s'.")] = None,
    outputs: Annotated[Text, typer.Option(help="Outputs of a board.")] = None,
    boards: Annotated[Text, typer.Option(help="Number of boards. Default: as few as have room.")] = None,
    first_node: Annotated[Text, typer.Option(help="Node id of the first board; the others follow.")] = None,
    island: Annotated[bool, typer.Option("--island", help="The boards are valve islands.")] = False,
    error_state: Annotated[Text, typer.Option(help="off, hold, device: see the page.")] = None,
    wiring: Annotated[Text, typer.Option(help="rows, or csv beside the file.")] = None,
    defaults: Annotated[bool, typer.Option("--defaults", help="Ask nothing: take defaults.")] = False,
) -> None:
    """Write a new arm's file, with comments, from options and questions. Nothing is written over.

    On a terminal it asks for what no option gives. Kinds of modules: prismatic, revolute, vgt, stewart.
    """
    refuse_existing(file, table=False)
    given = {"name": arm_name, "unit": unit, "repeat": repeat, "tolerance": tolerance, "travel_time": travel_time}
    given |= {"valves": valves, "pulse": pulse, "end_stops": end_stops, "bus": bus, "bitrate": bitrate}
    given |= {"outputs": outputs, "boards": boards, "first_node": first_node, "island": "yes" if island else None}
    given |= {"error_state": error_state, "wiring": wiring}
    asks = not defaults and sys.stdin.isatty()
    if not module and not asks:
        raise InputFaults(Path("--module"), ["at least one module is needed, such as 'prismatic strokes=50 link=60'"])
    answers = collected({field: text for field, text in given.items() if text is not None}, module or [], file, asks)
    refuse_existing(file, table=answers.wiring == "csv")
    command = command_of(answers, file)
    try:
        made = new_file(answers, file, command)
    except ValueError as error:
        raise InputFaults(file, [f"{error}; nothing is written"]) from None
    try_out(made, file, command)
    write(made, file)
    beside = f" and {table_name(file)} beside it" if made.table is not None else ""
    common.console.print(f"{file}{beside}: {made.size}")
    common.console.print(f"Next: hyperbit check {file} --picture {file.stem}.png --wiring {file.stem}-wiring.png")
    common.console.print(f"      hyperbit run {file} --simulate")


def command_of(answers: Answers, file: Path) -> str:
    """Returns the command that gives these answers."""
    usual, words = Answers(file.stem, ()), ["hyperbit", "new", file.name]
    for text in answers.modules:
        words += ["--module", text]
    for field, value in answers._asdict().items():
        if field == "modules" or value == getattr(usual, field):
            continue
        words += [f"--{field.replace('_', '-')}"] + ([] if value is True else [f"{value}"])
    return shlex.join([*words, "--defaults"])


def refuse_existing(file: Path, *, table: bool) -> None:
    """Raises InputFaults if a file to be written exists."""
    for path in (file, *([file.with_name(table_name(file))] if table else [])):
        if path.exists() or path.is_symlink():
            raise InputFaults(path, ["the file exists, and is not written over: name another, or move it away"])


def try_out(made: NewFile, file: Path, command: str) -> None:
    """Reads the new file as the commands will. Raises InputFaults with the lines that it would have."""
    with tempfile.TemporaryDirectory() as folder:
        draft = Path(folder) / file.name
        draft.write_text(made.text, encoding="utf-8")
        if made.table is not None:
            draft.with_name(table_name(file)).write_text(made.table, encoding="utf-8")
        try:
            checked_arm(draft, as_json=False)
        except InputFaults as error:
            words = f"nothing is written; these answers are those of {command}"
            raise InputFaults(file, [*error.faults, words], [*error.lines, None]) from None


def write(made: NewFile, file: Path) -> None:
    """Writes table and file. Raises CommandFailed, and leaves nothing behind."""
    written = list[Path]()
    try:
        for path, text in ((file.with_name(table_name(file)), made.table), (file, made.text)):
            if text is not None:
                with path.open("x", encoding="utf-8") as stream:
                    written.append(path)
                    stream.write(text)
    except OSError as error:
        for path in written:
            path.unlink(missing_ok=True)
        raise CommandFailed(f"{error.filename or file}: {error.strerror}; nothing is written") from None
