"""The command `halt`: stops an arm, also past the planner and Zenoh.

With `--local` this module imports as little as possible, so that the executor is asked at once.
"""

from __future__ import annotations

import json
from pathlib import Path
from socket import AF_UNIX, SOCK_SEQPACKET
from socket import socket as Socket
from typing import Annotated

import typer

from hyperbit.controller.host.sockets import found_sockets, socket_path
from hyperbit.controller.program import MOST_BYTES, VERSION, Answer, Goodbye, Hello, Malformed, Stop, decode_up, encode

ENDPOINT = "tcp/127.0.0.1:7447"  # as in hyperbit.controller.commands.connection, which takes longer to import
ARM = "The arm's file, or its name. With --local it may be absent: all arms of this computer."
LOCAL = "Ask the executor of this computer directly at its socket, without planner and Zenoh."
ALL = "Stop all arms of the network, also below namespaces, and tell which have stopped."  # as in `stop`
ZENOH = "Zenoh configuration file, instead of an endpoint."
ANSWER_WITHIN = 1.0  # [s]
JOIN = "join the executor's group: sudo usermod --append --groups hyperbit USER, or use sudo"
SEARCH = "name the executor's socket or its folder by --socket, or start an executor: hyperbit run ARM.yaml"


def halt(
    arm: Annotated[str, typer.Argument(metavar="ARM", help=ARM, show_default=False)] = "",
    local: Annotated[bool, typer.Option("--local", help=LOCAL)] = False,
    all_arms: Annotated[bool, typer.Option("--all", help=ALL)] = False,
    socket: Annotated[Path | None, typer.Option(help="With --local: the socket, or its folder.")] = None,
    connect: Annotated[str, typer.Option(help="Zenoh endpoint of the daemon.")] = ENDPOINT,
    zenoh_file: Annotated[Path | None, typer.Option("--zenoh", help=ZENOH)] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """Stop the arm as `stop` does; --local needs neither planner nor Zenoh. No substitute for a power switch."""
    if local and not (arm and all_arms):
        halt_here(arm, socket, as_json)
        return
    from hyperbit.controller.armfile.strict import InputFaults
    from hyperbit.controller.commands.use.requests import stop

    if bool(arm) == all_arms:
        raise InputFaults(Path("halt"), ["give either the arm's name, --all or --local"])
    if socket is not None:
        raise InputFaults(Path("--socket"), ["only with --local"])
    stop(arm, all_arms, connect, zenoh_file, as_json)


def halt_here(arm: str, socket: Path | None, as_json: bool) -> None:
    """Halts an arm, or all arms, and prints the executors' answers.

    Raises:
        CommandFailed: an executor did not answer, or there is none.
    """
    if arm.endswith((".yaml", ".yml")) or Path(arm).is_file():
        from hyperbit.controller.commands.common import arm_name

        arm = arm_name(arm)
    answer = halt_local(arm, socket)
    typer.echo(json.dumps({"accepted": True, "message": answer}) if as_json else answer)


def halt_local(name: str = "", path: Path | None = None) -> str:
    """Halts an arm, or all arms whose executors run on this computer.

    Args:
        name: name of the arm; "": all arms.
        path: path of the executor's socket or of its folder; None: the default paths.

    Returns:
        The executors' answers, one in each line.

    Raises:
        CommandFailed: an executor did not answer, or there is none.
    """
    if name:
        paths = [socket_path(path, name)]
    elif path is not None:
        paths = [path] if path.suffix == ".sock" else sorted(path.glob("*.sock"))
    else:
        paths = found_sockets()
    answers, failures, step = [], [], ""
    for own in paths:
        try:
            answers.append(f"{own.stem}: {halt_at(own, name)}")
        except OSError as error:
            step = JOIN if isinstance(error, PermissionError) else step
            failures.append(f"{own}: no executor answers ({error.strerror or error})")
        except Malformed as error:
            failures.append(f"{own}: {error}")
    if failures or not paths:
        from hyperbit.controller.commands.common import CommandFailed

        lines = "\n".join([*answers, *failures])
        raise CommandFailed(lines or "no executor is running: there is no socket", step if lines else SEARCH)
    return "\n".join(answers)


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
