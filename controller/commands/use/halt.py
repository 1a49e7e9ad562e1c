"""The command `halt`: stops arms of this computer at the executors' sockets, past the planner and Zenoh.

This module imports as little as possible, so that the executor is asked at once.
"""

from __future__ import annotations

import json
from pathlib import Path
from socket import AF_UNIX, SOCK_SEQPACKET
from socket import socket as Socket
from typing import Annotated, NamedTuple

import typer

from hyperbit.controller.commands.arguments import AsJson
from hyperbit.controller.host.sockets import found_sockets, socket_path
from hyperbit.controller.program import MOST_BYTES, VERSION, Answer, Goodbye, Hello, Malformed, Stop, decode_up, encode

ARM = "The arm's file, or its name. Without it: all arms of this computer."
ANSWER_WITHIN = 1.0  # [s]
JOIN = "join the executor's group: sudo usermod --append --groups hyperbit USER, or use sudo"
SEARCH = "name the executor's socket or its folder by --socket, or stop an arm elsewhere: hyperbit stop ARM"


def halt(
    arm: Annotated[str, typer.Argument(metavar="ARM", help=ARM, show_default=False)] = "",
    socket: Annotated[Path | None, typer.Option(help="Socket of the executor, or its folder.")] = None,
    as_json: AsJson = False,
) -> None:
    """Stop arms of this computer, without planner and Zenoh. No substitute for a power switch."""
    if arm.endswith((".yaml", ".yml")) or Path(arm).is_file():
        from hyperbit.controller.commands.common import arm_name

        arm = arm_name(arm)
    halts = halt_local(arm, socket)
    for each in halts:
        if as_json:
            typer.echo(json.dumps({"arm": each.arm, "accepted": each.step is None, "message": each.message}))
        elif each.step is None:
            typer.echo(f"{each.arm}: {each.message}")
    if steps := [each.step for each in halts if each.step is not None]:
        from hyperbit.controller.commands.common import CommandFailed

        failures = "\n".join(f"{each.arm}: {each.message}" for each in halts if each.step is not None)
        raise CommandFailed(failures, JOIN if JOIN in steps else SEARCH)


class Halt(NamedTuple):
    """What became of the halt of one arm; `step` is what to do if it failed."""

    arm: str
    message: str
    step: str | None = None


def halt_local(name: str = "", path: Path | None = None) -> list[Halt]:
    """Halts an arm, or all arms whose executors run on this computer.

    Args:
        name: name of the arm; "": all arms.
        path: path of the executor's socket or of its folder; None: the default paths.
    """
    if name:
        paths = [socket_path(path, name)]
    elif path is not None:
        paths = [path] if path.suffix == ".sock" else sorted(path.glob("*.sock"))
    else:
        paths = found_sockets()
    halts = []
    for own in paths:
        try:
            halts.append(Halt(own.stem, halt_at(own, name)))
        except OSError as error:
            step = JOIN if isinstance(error, PermissionError) else SEARCH
            halts.append(Halt(own.stem, f"{own}: no executor answers ({error.strerror or error})", step))
        except Malformed as error:
            halts.append(Halt(own.stem, f"{own}: {error}", SEARCH))
    return halts or [Halt(name, "no executor is running: there is no socket", SEARCH)]


def halt_at(path: Path, name: str) -> str:
    """Halts the arm of a socket; returns the executor's answer.

    Raises:
        OSError: the executor does not answer.
        Malformed: the answer is no message of the contract.
    """
    with Socket(AF_UNIX, SOCK_SEQPACKET) as connection:
        connection.settimeout(ANSWER_WITHIN)
        connection.connect(str(path))
        connection.send(encode(Hello(VERSION, "operator", name)))
        connection.send(encode(Stop(1)))
        while True:
            data = connection.recv(MOST_BYTES + 1)
            if not data:
                raise ConnectionAbortedError(None, "the executor closed the connection")
            match decode_up(data):
                case Answer() as answer:
                    return answer.message
                case Goodbye() as goodbye:
                    raise ConnectionRefusedError(None, goodbye.reason)
