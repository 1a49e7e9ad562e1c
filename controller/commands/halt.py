"""The command that stops an arm, also past the planner and Zenoh: halt.

With `--local` it imports as little as it can, so that it acts at once.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

ENDPOINT = "tcp/127.0.0.1:7447"  # as in controller.commands.common, which takes longer to import
ARM = "The arm's file, or its name; with --local all arms of this computer if absent."
LOCAL = "Ask the executor on this computer at its socket, past planner and Zenoh."
ZENOH = "Zenoh configuration file, in place of the endpoint."


def halt(
    arm: Annotated[str, typer.Argument(metavar="ARM", help=ARM, show_default=False)] = "",
    local: Annotated[bool, typer.Option("--local", help=LOCAL)] = False,
    socket: Annotated[Path | None, typer.Option(help="With --local: the socket, or its folder.")] = None,
    connect: Annotated[str, typer.Option(help="Zenoh endpoint of the daemon.")] = ENDPOINT,
    zenoh_file: Annotated[Path | None, typer.Option("--zenoh", help=ZENOH)] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """Stop the arm as `stop`, or --local past planner and Zenoh. No substitute for a switch that cuts the power."""
    if local:
        halt_here(arm, socket, as_json)
        return
    from controller.commands.tell import stop
    from controller.strict import InputFaults

    if not arm:
        raise InputFaults(Path("halt"), ["give the arm's name, or --local"])
    if socket is not None:
        raise InputFaults(Path("--socket"), ["only with --local"])
    stop(arm, connect, zenoh_file, as_json)


def halt_here(arm: str, socket: Path | None, as_json: bool) -> None:
    """Halts an arm, or all arms, by the executors' sockets.

    Raises:
        Failed: an executor did not answer, or there is none.
    """
    from controller.commands.halt_local import halt_local

    if arm.endswith((".yaml", ".yml")) or Path(arm).is_file():
        from controller.commands.common import arm_name

        arm = arm_name(arm)
    answer = halt_local(arm, socket)
    typer.echo(json.dumps({"accepted": True, "message": answer}) if as_json else answer)
