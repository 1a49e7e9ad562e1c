"""The command that stops an arm, also past the planner and Zenoh: halt. With --local, rich and Zenoh are not loaded."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Annotated

import typer

ENDPOINT = "tcp/127.0.0.1:7447"
ARM = "The arm's file, or its name; with --local all arms of this computer, if it is left out."
LOCAL = "Ask the executor on this computer at its socket, past planner and Zenoh."


def halt(
    arm: Annotated[str, typer.Argument(metavar="[ARM]", help=ARM, show_default=False)] = "",
    local: Annotated[bool, typer.Option("--local", help=LOCAL)] = False,
    socket: Annotated[Path | None, typer.Option(help="With --local: the socket, or its folder.")] = None,
    connect: Annotated[str, typer.Option(help="Zenoh endpoint of the daemon.")] = ENDPOINT,
    zenoh_file: Annotated[
        Path | None, typer.Option("--zenoh", help="Zenoh configuration file, in place of the endpoint.")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """Have the arm hold and take nothing until reset, as `stop`. No substitute for a switch that cuts the power."""
    if local:
        from controller.commands.halt_local import halt_local

        answer = halt_local(name_of(arm), socket)
        sys.stdout.write((json.dumps({"accepted": True, "message": answer}) if as_json else answer) + "\n")
        return
    refuse_without_local(arm, socket)
    from controller.commands.tell import stop

    stop(arm, connect, zenoh_file, as_json)


def name_of(arm: str) -> str:
    """Returns the name of an arm given by its file or by its name; "" if none is given."""
    if not arm.endswith((".yaml", ".yml")):
        return arm
    from controller.commands.common import arm_name

    return arm_name(arm)


def refuse_without_local(arm: str, socket: Path | None) -> None:
    """Refuses what is possible with --local only.

    Raises:
        InputFaults: there is such.
    """
    from controller.strict import InputFaults

    if socket is not None:
        raise InputFaults(Path("--socket"), ["only with --local"])
    if not arm:
        raise InputFaults(Path("halt"), ["an arm is needed; without one, --local halts all arms of this computer"])
