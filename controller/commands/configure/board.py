"""The command `board`: reads the errors of one board, or resets it while no executor runs."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from socket import AF_UNIX, SOCK_SEQPACKET
from socket import socket as Socket
from typing import Annotated, Literal

import typer

from hyperbit.controller.armfile.actuators import read_wired
from hyperbit.controller.armfile.strict import InputFaults
from hyperbit.controller.armfile.terminals import named_boards
from hyperbit.controller.commands.arguments import ArmFile, AsJson
from hyperbit.controller.commands.common import CommandFailed, print_json
from hyperbit.controller.commands.configure.executor_absence import executor_places, session_without_executor
from hyperbit.controller.program import (
    MOST_BYTES,
    VERSION,
    BoardErrors,
    Goodbye,
    Hello,
    Malformed,
    ReadErrors,
    decode_up,
    encode,
)
from hyperbit.drivers.canopen.sdo import errors
from hyperbit.drivers.canopen.sdo.client import Transfer
from hyperbit.drivers.canopen.sdo.dictionary import Dictionary
from hyperbit.drivers.canopen.sdo.errors import Errors
from hyperbit.drivers.canopen.sdo.procedure import Procedure
from hyperbit.drivers.canopen.tools.session import Node, Session, stopped
from hyperbit.drivers.canopen.wire import cia301
from hyperbit.drivers.canopen.wire.cia301 import Command, State
from hyperbit.drivers.canopen.wiring import BusWiring

BOARD = "Bus and node id, such as can0/5."
ACTION = "errors: read 1001h and the error history 1003h. reset: NMT reset; outputs go off, actuators may move."
COMMUNICATION = "NMT reset of communication only: it ends errors without a cause, and clears 1003h."
ANSWER_WITHIN = 10.0  # [s] for a slow board, after a boot
SOCKET = "Socket of the arm's executor, or its folder; the command checks that no executor answers there."


def board(
    file: ArmFile,
    name: Annotated[str, typer.Argument(metavar="BOARD", help=BOARD, show_default=False)],
    action: Annotated[Literal["errors", "reset"], typer.Argument(metavar="ACTION", help=ACTION, show_default=False)],
    yes: Annotated[bool, typer.Option("--yes", help="Do not ask before a reset.")] = False,
    communication: Annotated[bool, typer.Option("--communication", help=COMMUNICATION)] = False,
    socket: Annotated[Path | None, typer.Option(help=SOCKET, show_default=False)] = None,
    as_json: AsJson = False,
) -> None:
    """Read the errors of one board, by its executor if one runs; or reset it, while the executor is stopped."""
    settings, _, _ = read_wired(file)
    places = {f"{bus}/{node}" for bus, node in named_boards(settings)}
    if name not in places:
        known = ", ".join(sorted(places, key=lambda place: (place.partition("/")[0], int(place.partition("/")[2]))))
        raise InputFaults(Path("board"), [f"{name!r} is no board of {file}, which has {known}"])
    bus_name, _, node = name.partition("/")
    [entry] = [entry for entry in settings.buses if entry.name == bus_name]
    bus = BusWiring(name=entry.name, interface=entry.interface, channel=entry.channel, bitrate=entry.bitrate)
    asked = (bus_name, int(node))
    if action == "errors":
        wait = settings.boards.boot_timeout + ANSWER_WITHIN
        if (found := errors_by_executor(executor_places(settings.name, socket), settings.name, name, wait)) is not None:
            return show_errors(found, name, as_json)
    with session_without_executor([bus], settings.name, socket, settings.boards.heartbeat) as session:
        if action == "errors":
            show_errors(errors_by_bus(session, asked), name, as_json)
        else:
            command = Command.RESET_COMMUNICATION if communication else Command.RESET_NODE
            reset(session, asked, command, settings.boards.boot_timeout, yes, as_json)


def errors_by_executor(places: Iterable[Path], arm: str, name: str, wait: float) -> Errors | None:
    """Asks the executor of an arm for the errors of a board; returns None if no executor answers.

    Args:
        places: where its socket may be.
        wait: longest time for the answer [s]: a boot ends before.
    """
    for place in places:
        with Socket(AF_UNIX, SOCK_SEQPACKET) as connection:
            connection.settimeout(wait)
            try:
                connection.connect(str(place))
            except OSError:
                continue
            try:
                connection.send(encode(Hello(VERSION, "operator", arm)))
                connection.send(encode(ReadErrors(1, name)))
                while data := connection.recv(MOST_BYTES + 1):
                    match decode_up(data):
                        case BoardErrors(why="") as told:
                            return Errors(told.register, told.history, told.complete)
                        case BoardErrors(why=reason) | Goodbye(reason=reason):
                            raise CommandFailed(f"{place}: {reason}")
            except (OSError, Malformed) as error:
                raise CommandFailed(f"{place}: the executor does not answer ({error})") from None
            raise CommandFailed(f"{place}: the executor closed the connection")
    return None


def errors_by_bus(session: Session, node: Node) -> Errors:
    name, found = f"{node[0]}/{node[1]}", list[Errors]()

    def steps() -> Procedure:
        if (yield Transfer(0x1000, 0)).silence is not None:
            yield from session.poll_state(node)
            return
        it = Dictionary(name)
        register = yield from errors.read_register(it)
        found.append((yield from errors.read_history(it, register)))

    fault = session.run({node: steps()})[node] or session.trouble(node[0])
    if found:
        return found[0]
    if session.states.get(node) is State.STOPPED:
        raise CommandFailed(stopped(name))
    text = f"board {name} does not answer: check its power supply and its node id"
    raise CommandFailed(text if fault is None else fault.message)


def show_errors(found: Errors, name: str, as_json: bool) -> None:
    standing, history = {sub for sub, _ in found.standing}, found.history or ()
    if as_json:
        print_json({"board": name, "register": found.register, "history": history, "standing": sorted(standing)})
        return
    typer.echo(f"1001h = {found.register:02X}h")
    if found.history is None:
        typer.echo("no 1003h (error history)")
    else:
        typer.echo(f"1003h: {len(history)} entries" if history else "1003h: empty")
    for sub, value in enumerate(history, 1):
        ended = "" if sub in standing or not value & 0xFF00 else ", has ended"
        typer.echo(f"{value:08X}h {cia301.emergency_words(value & 0xFFFF)}{ended}")


def reset(session: Session, node: Node, command: Command, timeout: float, yes: bool, as_json: bool) -> None:
    name = f"{node[0]}/{node[1]}"
    question = f"A reset switches the outputs of board {name} off: its actuators may move. Continue?"
    if command is Command.RESET_COMMUNICATION:
        question = f"A reset may switch the outputs of board {name} off: its actuators may move. Continue?"
    if not yes:
        if not typer.confirm(question, err=True):
            raise CommandFailed("nothing was reset")
        session.listen()  # an executor may have been started meanwhile
    booted_after = session.reset(node, timeout, command)
    if booted_after is None:
        raise CommandFailed(f"board {name} sent no boot-up message within {timeout:g} s (boards.boot_timeout)")
    if as_json:
        print_json({"board": name, "booted_after": booted_after})
    else:
        typer.echo(f"board {name} has booted after {booted_after:.2f} s; it is pre-operational")
