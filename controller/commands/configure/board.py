"""The command `board`: reads the errors of one board, or resets it, while no executor runs."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

from controller.armfile.actuators import read_wired
from controller.armfile.settings import ArmSettings
from controller.armfile.strict import InputFaults
from controller.armfile.terminals import named_boards
from controller.commands.common import ArmFile, AsJson, CommandFailed, print_json
from controller.commands.configure.executor_absence import refuse_executor, running_on
from controller.commands.configure.probe import errors
from drivers.canopen.faults import BusError
from drivers.canopen.tools.node_reset import reset_node
from drivers.canopen.tools.node_states import stopped
from drivers.canopen.tools.probe import Probe, probe_bus
from drivers.canopen.wire.cia301 import State
from drivers.canopen.wiring import BusWiring

BOARD = "Bus and node id, such as can0/5."
ACTION = "errors: read 1001h and the error history 1003h. reset: NMT reset; outputs go off, actuators may move."
SOCKET = "Socket of the arm's executor, or its folder; the command checks that no executor answers there."


def board(
    file: ArmFile,
    name: Annotated[str, typer.Argument(metavar="BOARD", help=BOARD, show_default=False)],
    action: Annotated[Literal["errors", "reset"], typer.Argument(metavar="ACTION", help=ACTION, show_default=False)],
    yes: Annotated[bool, typer.Option("--yes", help="Do not ask before a reset.")] = False,
    socket: Annotated[Path | None, typer.Option(help=SOCKET, show_default=False)] = None,
    as_json: AsJson = False,
) -> None:
    """Read the errors of one board, or reset it, while the arm's executor is stopped."""
    settings, _, _ = read_wired(file)
    places = {f"{bus}/{node}" for bus, node in named_boards(settings)}
    if name not in places:
        known = ", ".join(sorted(places, key=lambda place: (place.partition("/")[0], int(place.partition("/")[2]))))
        raise InputFaults(Path("board"), [f"{name!r} is no board of {file}, which has {known}"])
    bus_name, _, node = name.partition("/")
    [entry] = [entry for entry in settings.buses if entry.name == bus_name]
    bus = BusWiring(name=entry.name, interface=entry.interface, channel=entry.channel, bitrate=entry.bitrate)
    try:
        refuse_executor([bus], settings.name, socket, settings.boards.heartbeat)
        found = probe_bus(bus, [int(node)])
        if found.fault is not None:
            raise CommandFailed(found.fault.message)
        if found.master_heard:
            raise running_on(bus_name)
        if action == "errors":
            show_errors(found, name, as_json)
        else:
            reset(settings, bus, name, yes, as_json)
    except BusError as error:
        raise CommandFailed(str(error)) from None


def show_errors(found: Probe, name: str, as_json: bool) -> None:
    """Prints error register and error history of a probed board.

    Raises:
        CommandFailed: the board does not answer.
    """
    if found.found and not found.found[0].answers and found.found[0].state is State.STOPPED:
        raise CommandFailed(stopped(name))
    if not found.found or not found.found[0].answers:
        raise CommandFailed(f"board {name} does not answer: check its power supply and its node id")
    it = found.found[0]
    if as_json:
        history = [it.numbers.get((0x1003, sub)) for sub in range(1, 1 + it.numbers.get((0x1003, 0), 0))]
        print_json({"board": name, "register": it.numbers.get((0x1001, 0)), "history": history})
        return
    for line in errors(it):
        typer.echo(line)


def reset(settings: ArmSettings, bus: BusWiring, name: str, yes: bool, as_json: bool) -> None:
    """Resets a board and prints how long it took to boot.

    Raises:
        CommandFailed: the board does not boot, or the user declined.
    """
    question = f"A reset switches the outputs of board {name} off: its actuators may move. Continue?"
    if not yes and not typer.confirm(question, err=True):
        raise CommandFailed("nothing was reset")
    timeout = settings.boards.boot_timeout
    it = reset_node(bus, int(name.rpartition("/")[2]), timeout)
    if it.fault is not None:
        raise CommandFailed(it.fault.message)
    if it.booted_after is None:
        raise CommandFailed(f"board {name} sent no boot-up message within {timeout:g} s (boards.boot_timeout)")
    if as_json:
        print_json({"board": name, "booted_after": it.booted_after})
    else:
        typer.echo(f"board {name} has booted after {it.booted_after:.2f} s; it is pre-operational")
