"""The command `check`: checks an arm's file, and its boards by the bus or by their EDS."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from controller.commands import common
from controller.commands.common import ArmFile, AsJson, Failed, print_json
from controller.strict import InputFaults
from controller.terminals import actuator_terminals

if TYPE_CHECKING:
    from controller.config import Arm


def check(
    file: ArmFile,
    bus: Annotated[bool, typer.Option("--bus", help="Also read each board; changes nothing on it.")] = False,
    eds: Annotated[
        Path | None, typer.Option(help="Maker's electronic data sheet (EDS) of the boards: compare it, without a bus.")
    ] = None,
    node: Annotated[str | None, typer.Option(help="Only board that the EDS describes, such as can0/5.")] = None,
    as_json: AsJson = False,
) -> None:
    """Check an arm's file and name each fault by its field; --bus also reads the boards.

    Example: hyperbit check my-arm.yaml --eds 750-337.eds --node can0/5
    """
    from controller.config import load
    from controller.executor.arm import read_arm

    if node is not None and eds is None:
        raise InputFaults(Path("check"), ["--node needs --eds FILE"])

    try:
        arm = load(file)
        if arm.wiring:
            read_arm(file)  # refuses process data that do not fit on the boards
    except InputFaults as error:
        if as_json:
            print_json({"ok": False, "faults": list(error.faults)})
            raise typer.Exit(2) from None
        raise
    boards = compare(arm, eds, node) if eds is not None else []
    boards += ask_boards(arm) if bus else []
    missing = [f"{board['board']}: {board['answer']}" for board in boards if not board["ok"]]
    if as_json:
        print_json({"ok": not missing, "faults": missing, "boards": boards})
    else:
        count = len({terminal.board for entry in arm.wiring for terminal in actuator_terminals(entry)})
        common.console.print(
            f"{file}: arm {arm.settings.name}, {len(arm.manipulator.modules)} modules,"
            f" {len(arm.manipulator.actuators)} actuators on {count} boards: no fault"
        )
        for board in boards:
            common.console.print(f"  {board['board']}: {board['answer']}", style=None if board["ok"] else "red")
    if missing:
        if as_json:
            raise typer.Exit(1)
        raise Failed(f"{len(missing)} of {len(boards)} boards do not answer, or lack an object that hyperbit needs")


def ask_boards(arm: Arm) -> list[dict[str, Any]]:
    """Reads each board of an arm; returns an answer for each.

    Raises:
        Failed: a bus cannot be used.
    """
    from controller.executor.arm import timing_of, wiring_of
    from drivers.canopen.faults import BusError
    from drivers.canopen.tools.probe import probe

    try:
        answers = probe(wiring_of(arm.settings, arm.manipulator.actuators, arm.wiring), timing_of(arm.settings))
    except BusError as error:
        raise Failed(str(error)) from None
    return [{"board": answer.board, "ok": answer.ok, "answer": answer.text} for answer in answers]


def compare(arm: Arm, eds: Path, node: str | None) -> list[dict[str, Any]]:
    """Compares the boards of an arm with an EDS; returns an answer for each board, naming what the EDS lacks.

    Args:
        arm: the arm.
        eds: path of the EDS.
        node: the only board to compare; None: all boards.

    Raises:
        InputFaults: the file is no EDS, or the arm has no such board.
    """
    from controller.executor.arm import timing_of, wiring_of
    from drivers.canopen.layout import lay_out
    from drivers.canopen.tools.eds_check import Eds, UnreadableEds, lacks

    wiring = wiring_of(arm.settings, arm.manipulator.actuators, arm.wiring)
    boards = {board.name: board for board in lay_out(wiring).boards}
    if node is not None and node not in boards:
        raise InputFaults(Path("--node"), [f"{node}: the arm has no such board, only {', '.join(boards)}"])
    answers = []
    for name, board in boards.items():
        if node in (None, name):
            try:
                found = lacks(Eds(eds, board.node), board, timing_of(arm.settings), wiring.error_state)
            except UnreadableEds as error:
                raise InputFaults(eds, [str(error)]) from None
            text = "; ".join(map(str, found)) or f"has all needed objects, according to {eds.name}"
            answers.append({"board": name, "ok": not found, "answer": text, "lacks": [one._asdict() for one in found]})
    return answers
