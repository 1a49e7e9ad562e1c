"""Commands that send one request without content to a running daemon: cancel, stop and reset."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from msgspec import to_builtins

from hyperbit.controller.armfile.strict import InputFaults
from hyperbit.controller.commands import ENDPOINT
from hyperbit.controller.commands.arguments import ArmName, AsJson, Connect, ZenohFile
from hyperbit.controller.commands.common import CommandFailed, print_json
from hyperbit.controller.commands.completion import complete_arms
from hyperbit.controller.commands.connection import ask, connected, named, open_session
from hyperbit.controller.messages.goals import Answer
from hyperbit.controller.network.endpoints import START

ALL = "Stop all arms of the network, also below namespaces, and tell which have stopped."
ANY_ARM = "The arm's file, or its name. With --all it is absent."


def cancel(arm: ArmName, connect: Connect = ENDPOINT, zenoh_file: ZenohFile = None, as_json: AsJson = False) -> None:
    """Cancel the running goal or stream of set-points; the arm holds and accepts the next goal."""
    with connected(arm, connect, zenoh_file, find=False) as client:
        ask(client, named(arm, connect, zenoh_file), "cancel", {}, as_json)


def stop(
    arm: Annotated[
        str, typer.Argument(metavar="ARM", help=ANY_ARM, show_default=False, autocompletion=complete_arms)
    ] = "",
    all_arms: Annotated[bool, typer.Option("--all", help=ALL)] = False,
    connect: Connect = ENDPOINT,
    zenoh_file: ZenohFile = None,
    as_json: AsJson = False,
) -> None:
    """Stop the arm: it holds and accepts no motion until reset. No substitute for a switch that cuts the power."""
    if bool(arm) == all_arms:
        raise InputFaults(Path("stop"), ["give either the arm's name, or --all"])
    if all_arms:
        stop_arms(connect, zenoh_file, as_json)
        return
    with connected(arm, connect, zenoh_file, find=False) as client:
        ask(client, named(arm, connect, zenoh_file), "stop", {}, as_json)


def stop_arms(connect: str, zenoh_file: Path | None, as_json: bool) -> None:
    from hyperbit.controller.network.stop_all import stop_all

    with open_session(connect, zenoh_file) as session:
        report = stop_all(session)
    silent = Answer(accepted=False, message="no answer: stop it by another way, and cut its power if it moves")
    answers = {**report.answers, **dict.fromkeys(report.silent, silent)}
    failures = []
    for arm, answer in answers.items():
        if as_json:
            print_json({"name": arm.name, "namespace": arm.namespace, **to_builtins(answer)})
        if not answer.accepted:
            failures.append(f"{arm}: {answer.message}")
        elif not as_json:
            typer.echo(f"{arm}: {answer.message}")
    if failures:
        raise CommandFailed("\n".join(failures))
    if not answers:
        raise CommandFailed(f"no arm at {zenoh_file or connect}", START)


def reset(arm: ArmName, connect: Connect = ENDPOINT, zenoh_file: ZenohFile = None, as_json: AsJson = False) -> None:
    """Leave a stop or a fault. Nothing moves."""
    with connected(arm, connect, zenoh_file) as client:
        ask(client, named(arm, connect, zenoh_file), "reset", {}, as_json)
