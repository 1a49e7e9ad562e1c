"""Arguments and options that the commands share."""

from pathlib import Path
from typing import Annotated

import typer

from hyperbit.controller.commands.completion import complete_arms, complete_files

ArmFile = Annotated[
    Path,
    typer.Argument(metavar="ARM.yaml", help="The arm's file.", show_default=False, autocompletion=complete_files),
]
ArmName = Annotated[
    str,
    typer.Argument(
        metavar="ARM", help="The arm's file, or its name.", show_default=False, autocompletion=complete_arms
    ),
]
AsJson = Annotated[bool, typer.Option("--json", help="Print JSON.")]
Connect = Annotated[str, typer.Option(help="Zenoh endpoint of the daemon.")]
ZenohFile = Annotated[Path | None, typer.Option("--zenoh", help="Zenoh configuration file, instead of an endpoint.")]
