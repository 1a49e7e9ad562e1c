"""The command that stops an arm, also past the planner and Zenoh: halt."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from controller.commands.common import ENDPOINT, ArmName, AsJson, Connect, ZenohFile, arm_name, console, print_json
from controller.strict import InputFaults

LOCAL = "Ask the executor on this computer at its socket, past planner and Zenoh."


def halt(
    arm: ArmName,
    local: Annotated[bool, typer.Option("--local", help=LOCAL)] = False,
    socket: Annotated[Path | None, typer.Option(help="With --local: the socket, or its folder.")] = None,
    connect: Connect = ENDPOINT,
    zenoh_file: ZenohFile = None,
    as_json: AsJson = False,
) -> None:
    """Have the arm hold and take nothing until reset, as `stop`. No substitute for a switch that cuts the power."""
    if socket is not None and not local:
        raise InputFaults(Path("--socket"), ["only with --local"])
    if local:
        from controller.commands.halt_local import halt_local

        answer = halt_local(arm_name(arm), socket)
        if as_json:
            print_json({"accepted": True, "message": answer})
        else:
            console.print(answer, markup=False)
        return
    from controller.commands.tell import stop

    stop(arm, connect, zenoh_file, as_json)
