"""Arguments and options that several commands share. It imports nothing slow: `hyperbit halt` uses it."""

from pathlib import Path
from typing import Annotated

import typer

from hyperbit.controller.commands import CONNECT
from hyperbit.controller.commands.completion import complete_arms, complete_changes, complete_files

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
Picture = Annotated[Path, typer.Option(help="File for the picture.")]

# Of the network
Connect = Annotated[str, typer.Option(envvar=CONNECT, help="Zenoh endpoint of the daemon.")]
Listen = Annotated[str, typer.Option(help="Zenoh endpoint to accept connections at.")]
ZenohFile = Annotated[Path | None, typer.Option("--zenoh", help="Zenoh configuration file, instead of an endpoint.")]

# Of searches and studies
MOST_WORKERS = 1024
Tolerance = Annotated[
    float | None, typer.Option(help="Position tolerance, in the unit of the arm's file. Default: the arm's.")
]
Workers = Annotated[
    int, typer.Option(min=1, max=MOST_WORKERS, help="Number of processes on this computer that share the work.")
]
Dask = Annotated[
    str | None,
    typer.Option(metavar="ADDRESS", help="Scheduler of a Dask cluster that shares the work, such as tcp://host:8786."),
]

# Of actuators and boards
SWITCHES = "Actuator and the state to switch it to, contracted or extended, such as 5.left=extended."
LOCKS = "Actuator and state, such as 5.left=contracted: contracted or extended locks it, free unlocks it."
Switches = Annotated[
    list[str],
    typer.Argument(metavar="ACTUATOR=STATE", help=SWITCHES, show_default=False, autocompletion=complete_changes),
]
Locks = Annotated[
    list[str],
    typer.Argument(metavar="ACTUATOR=STATE", help=LOCKS, show_default=False, autocompletion=complete_changes),
]
Wait = Annotated[bool, typer.Option("--wait/--no-wait", help="Wait for the result, or for the answer only.")]
BOARD_KIND = "Kind of the simulated boards; see `simulate --help`."
OWN_RATE = "Bit rate of the bus [bit/s], 1,000,000 by default; not for socketcan, whose bit rate the system sets."
BoardKinds = Annotated[list[str], typer.Option(metavar="[BOARD=]KIND", help=BOARD_KIND, show_default=False)]
WIRED = "Arm's file that says how the simulated boards are wired in truth. Default: as ARM.yaml says."
Wired = Annotated[Path | None, typer.Option(metavar="TRUE.yaml", help=WIRED, show_default=False)]
Channel = Annotated[str, typer.Argument(metavar="CHANNEL", help="The bus, such as can0.", show_default=False)]
Interface = Annotated[str, typer.Option(help="Interface of python-can.")]
Bitrate = Annotated[int | None, typer.Option(min=10_000, max=1_000_000, help=OWN_RATE, show_default=False)]
