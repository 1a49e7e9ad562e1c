"""The command that switches single actuators: jog."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from controller.commands.common import ENDPOINT, ArmName, AsJson, Connect, ZenohFile
from controller.commands.talk import connected
from controller.commands.tell import STATES, ask
from controller.strict import InputFaults

CHANGES = "As in 5.left=extended: the state that the actuator switches to, contracted or extended."


def jog(
    arm: ArmName,
    changes: Annotated[list[str], typer.Argument(metavar="ACTUATOR=STATE", help=CHANGES, show_default=False)],
    connect: Connect = ENDPOINT,
    zenoh_file: ZenohFile = None,
    as_json: AsJson = False,
) -> None:
    """Switch single actuators, also if the arm is in no configuration. The arm moves."""
    actuators = dict[str, str]()
    for change in changes:
        actuator, _, state = change.partition("=")
        if not actuator.isprintable() or state not in STATES:
            form = "an actuator, =, and contracted or extended are needed, as in 5.left=extended"
            raise InputFaults(Path("jog"), [f"{change!r}: {form}"])
        if actuator in actuators:
            raise InputFaults(Path("jog"), [f"{change!r}: {actuator} stands twice"])
        actuators[actuator] = state
    with connected(arm, connect, zenoh_file) as client:
        ask(client, arm, "jog", {"actuators": actuators}, as_json)
