"""The command `fault`: plays a fault in the boards of a simulated arm."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from hyperbit.controller.armfile.strict import InputFaults
from hyperbit.controller.commands import ENDPOINT
from hyperbit.controller.commands.arguments import ArmName, AsJson, Connect, ZenohFile
from hyperbit.controller.commands.connection import ask, connected, named
from hyperbit.drivers.simulation.fault_commands import described

WORDS = "Verb, what it applies to, and for some verbs a number, such as: silence can0/5, or: stick 5.left 1."


def fault(
    arm: ArmName,
    words: Annotated[list[str], typer.Argument(metavar="VERB NAME [NUMBER]", help=WORDS, show_default=False)],
    connect: Connect = ENDPOINT,
    zenoh_file: ZenohFile = None,
    as_json: AsJson = False,
) -> None:
    """Play a fault in the boards of a simulated arm, or end it; an arm with real boards refuses."""
    if not (text := " ".join(words)).isprintable():
        raise InputFaults(Path("fault"), [f"{text!r}: letters, digits and / are needed, as in silence can0/5"])
    with connected(arm, connect, zenoh_file) as client:
        ask(client, named(arm, connect, zenoh_file), "fault", {"fault": text}, as_json)


fault.__doc__ = f"{fault.__doc__}\n\n\b\nVerbs:\n{described()}"
