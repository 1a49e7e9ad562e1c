"""The command `check`: checks an arm's file, and its boards by the bus or by their EDS."""

from __future__ import annotations

import json
import subprocess
from collections import Counter
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from hyperbit.controller.armfile.commissioned import warning_of
from hyperbit.controller.armfile.strict import InputFaults
from hyperbit.controller.armfile.terminals import named_boards
from hyperbit.controller.commands import common
from hyperbit.controller.commands.arguments import ArmFile, AsJson
from hyperbit.controller.commands.common import CommandFailed, drawing, print_json
from hyperbit.controller.host.files import read_file

if TYPE_CHECKING:
    from hyperbit.controller.arm.arm import Arm
    from hyperbit.controller.armfile.settings import BusSettings

SOCKET = "Socket of the arm's executor, or its folder; with --bus the command checks that no executor answers there."
SILENT = ("does not answer", "do not answer")
ATTEMPT = 5.0  # [s] for the command ip
KINDS = {  # of faults, by code: what one board does, and what several do
    "board-missing": SILENT,
    "board-stopped": ("is stopped", "are stopped"),
    "board-error": ("reports an error", "report an error"),
    "wrong-device": ("lacks an object or value that hyperbit needs", "lack an object or value that hyperbit needs"),
    "bit-rate": ("has another bit rate", "have another bit rate"),
    "sdo-unanswered": ("gives no answer for an object", "give no answer for an object"),
    "sdo-refused": ("refuses a value that hyperbit needs", "refuse a value that hyperbit needs"),
}


def check(
    file: ArmFile,
    bus: Annotated[bool, typer.Option("--bus", help="Also read each board; changes nothing on it.")] = False,
    eds: Annotated[
        Path | None, typer.Option(help="Maker's electronic data sheet (EDS) of the boards: compare it, without a bus.")
    ] = None,
    node: Annotated[str | None, typer.Option(help="Only board that the EDS describes, such as can0/5.")] = None,
    socket: Annotated[Path | None, typer.Option(help=SOCKET, show_default=False)] = None,
    picture: Annotated[
        Path | None, typer.Option(help="Draw the arm: PNG, PDF or SVG, by the suffix.", show_default=False)
    ] = None,
    wiring: Annotated[
        Path | None, typer.Option(help="Draw the wiring of each board, by the suffix as well.", show_default=False)
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Check an arm's file, name each fault by its line, and sum the arm up; --bus also reads the boards.

    Example: hyperbit check my-arm.yaml --eds 750-337.eds --node can0/5
    """
    if node is not None and eds is None:
        raise InputFaults(Path("check"), ["--node needs --eds FILE"])
    from hyperbit.controller.arm.summary import summarize
    from hyperbit.controller.arm.warnings import file_warnings

    arm = checked_arm(file, as_json)
    if (bus or eds is not None) and not arm.wiring:
        words = "the file has no boards, which --bus and --eds need: name them under buses and actuators"
        raise InputFaults(file, [words])
    fields, warnings = summarize(arm), file_warnings(arm)
    if (open_ := warning_of(file, arm.settings, arm.manipulator.actuators, arm.wiring)) is not None:
        warnings.append(open_)
    if picture is not None:
        draw(arm, picture)
    if wiring is not None:
        from hyperbit.controller.pictures import wiring_plots

        with drawing(wiring):
            wiring_plots.save(wiring, arm.settings)
    boards = compare(arm, eds, node) if eds is not None else []
    boards += ask_boards(arm, socket) if bus else []
    missing = [f"{board['board']}: {board['answer']}" for board in boards if not board["ok"]]
    if as_json:
        print_json({"ok": not missing, "faults": missing, "warnings": warnings, "boards": boards, "arm": fields})
    else:
        report(file, arm, fields, warnings, boards)
    if missing and as_json:
        raise typer.Exit(1)
    if missing:
        raise CommandFailed(summary([board["code"] for board in boards if not board["ok"]]))


def checked_arm(file: Path, as_json: bool) -> Arm:
    from hyperbit.controller.arm.arm import load
    from hyperbit.controller.executor.arm.arm import read_arm

    try:
        arm = load(file)
        if arm.wiring:
            read_arm(file)  # refuses process data that do not fit on the boards
    except InputFaults as error:
        if as_json:
            print_json({"ok": False, "faults": list(error.faults), "lines": list(error.lines)})
            raise typer.Exit(2) from None
        raise
    return arm


def draw(arm: Arm, picture: Path) -> None:
    """Draws an arm twice: with each module in its first state, and in its last."""
    from hyperbit.controller.pictures import plots

    first, last = arm.manipulator.states * 0, arm.manipulator.states - 1
    drawn = {"first state of each module": first, "last state of each module": last}
    with drawing(picture):
        subplot = plots.Subplot(arm.settings.name, drawn)
        plots.save(picture, arm.manipulator, None, [subplot], unit=arm.settings.unit, obstacles=arm.obstacles)


def report(file: Path, arm: Arm, fields: dict[str, Any], warnings: list[str], boards: list[dict[str, Any]]) -> None:
    """Prints the size of a correct arm, the warnings about its file, its summary, and the answers of its boards."""
    from hyperbit.controller.arm.summary import summary_lines

    count = len(named_boards(arm.settings))
    common.console.print(
        f"{file}: arm {arm.settings.name}, {len(arm.manipulator.modules)} modules,"
        f" {len(arm.manipulator.actuators)} actuators on {count} {'board' if count == 1 else 'boards'}: no fault"
    )
    for warning in warnings:
        common.console.print(f"Warning: {warning}", style="yellow")
    for name, value in summary_lines(fields):
        common.console.print(f"  {name:<15} {value}")
    for board in boards:
        style = None if board["ok"] else "red"
        common.console.print(f"  {board['board']}: {board['answer']}", style=style)
    for note in dict.fromkeys(note for board in boards for note in board.get("notes", ())):
        common.console.print(f"  EDS, {note}", style="dim")


def summary(codes: Iterable[str]) -> str:
    """Returns how many boards have which fault, e.g. "2 boards do not answer, 1 is stopped"; `codes`: one a board."""
    counts = Counter(KINDS.get(code, SILENT) for code in codes)
    kinds = [kind for kind in dict.fromkeys(KINDS.values()) if counts[kind]]
    parts = [f"{counts[kind]} {kind[counts[kind] > 1]}" for kind in kinds]
    first, _, verb = parts[0].partition(" ")
    return ", ".join([f"{first} board{'s' * (first != '1')} {verb}", *parts[1:]])


def wrong_rates(arm: Arm) -> Iterator[tuple[BusSettings, str]]:
    """Yields each bus whose interface has another bit rate than the arm's file, and both in words."""
    for bus in (bus for bus in arm.settings.buses if bus.interface == "socketcan"):
        command = ["ip", "-json", "-details", "link", "show", "dev", bus.channel]
        try:
            told = json.loads(subprocess.run(command, capture_output=True, timeout=ATTEMPT).stdout)
            info = told[0]["linkinfo"]["info_data"]
            rate = info["bittiming"]["bitrate"] if "bittiming" in info else info["bittiming_bitrate"]
        except (OSError, ValueError, LookupError, TypeError, subprocess.TimeoutExpired):
            continue  # no CAN interface of its own, or this computer cannot tell
        if rate and rate != bus.bitrate:
            where = f"/etc/systemd/network/80-{bus.channel}.network"
            yield bus, f"{bus.channel} has {rate} bit/s, the arm's file {bus.bitrate}: change {where} or the file"


def ask_boards(arm: Arm, socket: Path | None) -> list[dict[str, Any]]:
    from hyperbit.controller.commands.configure.executor_absence import session_without_executor
    from hyperbit.controller.executor.arm.arm import timing_of, wiring_of
    from hyperbit.drivers.canopen.tools.bus_check import check_bus

    wiring, timing = wiring_of(arm.settings, arm.manipulator.actuators, arm.wiring), timing_of(arm.settings)
    wrong = [{"board": bus.name, "ok": False, "answer": text, "code": "bit-rate"} for bus, text in wrong_rates(arm)]
    if wrong:
        return wrong
    with session_without_executor(wiring.buses, arm.settings.name, socket, timing.heartbeat) as session:
        told = check_bus(session, wiring, timing)
    return [{"board": a.board, "ok": not a.code, "answer": a.text, "code": a.code} for a in told]


def compare(arm: Arm, eds: Path, node: str | None) -> list[dict[str, Any]]:
    """Compares the boards of an arm, or one, with an EDS; returns an answer for each, naming what the EDS lacks."""
    from hyperbit.controller.executor.arm.arm import timing_of, wiring_of
    from hyperbit.drivers.canopen.layout import lay_out
    from hyperbit.drivers.canopen.tools.eds import Eds
    from hyperbit.drivers.canopen.tools.eds_check import lacks, unmet
    from hyperbit.drivers.canopen.tools.eds_file import UnreadableEds

    wiring = wiring_of(arm.settings, arm.manipulator.actuators, arm.wiring)
    boards = {board.name: board for board in lay_out(wiring).boards}
    if node is not None and node not in boards:
        raise InputFaults(Path("--node"), [f"{node}: the arm has no such board, only {', '.join(boards)}"])
    compared = [board for name, board in boards.items() if node in (None, name)]
    try:
        sheet = Eds(read_file(eds), compared[0].node)
    except OSError as error:
        raise InputFaults(eds, [f"cannot be read: {error.strerror}"]) from None
    except UnreadableEds as error:
        raise InputFaults(eds, [str(error)]) from None
    times = timing_of(arm.settings)
    answers = []
    for board in compared:
        of_board = sheet.at(board.node)
        found = lacks(of_board, board, times) or unmet(of_board, board, times)
        reasons = "; ".join(map(str, found))
        if not found:
            verdict, text = "fits", f"has all needed objects, according to {eds.name}"
        elif found[0].told:
            verdict, text = "lacks", reasons
        else:
            verdict, text = "open", f"{eds.name} does not tell whether it fits: {reasons}"
        lacking = verdict == "lacks"
        code = "wrong-device" if lacking else ""
        told = [one._asdict() for one in found]
        answer = {"board": board.name, "ok": not lacking, "verdict": verdict, "answer": text, "code": code}
        answers.append({**answer, "lacks": told, "notes": of_board.notes})
    return answers
