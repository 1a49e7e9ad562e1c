"""The command `board`: reads the errors of one board, or resets it, while no executor runs."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

from hyperbit.controller.armfile.actuators import read_wired
from hyperbit.controller.armfile.strict import InputFaults
from hyperbit.controller.armfile.terminals import named_boards
from hyperbit.controller.commands.arguments import ArmFile, AsJson
from hyperbit.controller.commands.common import CommandFailed, print_json
from hyperbit.controller.commands.configure.executor_absence import session_without_executor
from hyperbit.controller.commands.configure.probe import errors
from hyperbit.drivers.canopen.tools.probe import ProbedNode, probe_bus
from hyperbit.drivers.canopen.tools.session import Node, Session, stopped
from hyperbit.drivers.canopen.wire.cia301 import State
from hyperbit.drivers.canopen.wiring import BusWiring

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
    with session_without_executor([bus], settings.name, socket, settings.boards.heartbeat) as session:
        if action == "errors":
            show_errors(probe_bus(session, bus_name, [int(node)]), name, as_json)
        else:
            reset(session, (bus_name, int(node)), settings.boards.boot_timeout, yes, as_json)


def show_errors(found: list[ProbedNode], name: str, as_json: bool) -> None:
    if found and not found[0].answers and found[0].state is State.STOPPED:
        raise CommandFailed(stopped(name))
    if not found or not found[0].answers:
        raise CommandFailed(f"board {name} does not answer: check its power supply and its node id")
    it = found[0]
    if as_json:
        history = [it.numbers.get((0x1003, sub)) for sub in range(1, 1 + it.numbers.get((0x1003, 0), 0))]
        print_json({"board": name, "register": it.numbers.get((0x1001, 0)), "history": history})
        return
    for line in errors(it):
        typer.echo(line)


def reset(session: Session, node: Node, timeout: float, yes: bool, as_json: bool) -> None:
    name = f"{node[0]}/{node[1]}"
    question = f"A reset switches the outputs of board {name} off: its actuators may move. Continue?"
    if not yes:
        if not typer.confirm(question, err=True):
            raise CommandFailed("nothing was reset")
        session.listen()  # an executor may have been started meanwhile
    booted_after = session.reset(node, timeout)
    if booted_after is None:
        raise CommandFailed(f"board {name} sent no boot-up message within {timeout:g} s (boards.boot_timeout)")
    if as_json:
        print_json({"board": name, "booted_after": booted_after})
    else:
        typer.echo(f"board {name} has booted after {booted_after:.2f} s; it is pre-operational")
