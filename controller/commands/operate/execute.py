"""The command `execute`: becomes the executor's process."""

import os
import sys
from pathlib import Path
from typing import Annotated

import typer

from hyperbit.controller.commands.arguments import ArmFile, BoardKinds, Wired


def execute(
    file: ArmFile,
    socket: Annotated[Path | None, typer.Option(help="Socket to create for the planner, or its folder.")] = None,
    simulate: Annotated[bool, typer.Option("--simulate", help="Use simulated boards, in this process.")] = False,
    board: BoardKinds = [],  # noqa: B006  # typer needs a list
    wired: Wired = None,
    journal: Annotated[Path | None, typer.Option(help="File of the switch journal, which counts switches.")] = None,
    list_modules: Annotated[bool, typer.Option("--list-modules", hidden=True)] = False,
) -> None:
    """Run the executor until SIGTERM: it takes motion programs from a planner and commands boards over CAN."""
    options = [f"--socket={socket}"] * (socket is not None) + [f"--journal={journal}"] * (journal is not None)
    options += [f"--board={word}" for word in board] + [f"--wired={wired}"] * (wired is not None)
    flags = ["--simulate"] * simulate + ["--list-modules"] * list_modules
    # exec, because the executor's process must not contain the command line's modules; the process id stays the same.
    sys.stdout.flush()
    os.execv(
        sys.executable, [sys.executable, "-P", "-m", "hyperbit.controller.executor", *options, *flags, "--", str(file)]
    )
