"""Commands that send one request to a running daemon: cancel, stop, reset, jog, degrade, lock and obstacles."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Annotated, Any

import typer

from controller.armfile.strict import InputFaults
from controller.commands.common import ENDPOINT, ArmName, AsJson, Connect, ZenohFile
from controller.commands.connection import ask, connected, read_payload

STATES = ("contracted", "extended")  # as controller.manipulator.locked has them, without its import of NumPy
PAUSE = 0.002  # [s]; deploy/zenoh-tls.json5 drops a second request of a kind within a millisecond
LOCKS = "Actuator and state, such as 5.left=contracted: contracted or extended locks it, free unlocks it."
SWITCHES = "Actuator and the state to switch it to, contracted or extended, such as 5.left=extended."
REGIONS = "Obstacles, YAML or JSON: a list `regions`, written as `obstacles` in the arm's file."


def cancel(arm: ArmName, connect: Connect = ENDPOINT, zenoh_file: ZenohFile = None, as_json: AsJson = False) -> None:
    """Cancel the running goal or stream of set-points; the arm holds and accepts the next goal."""
    with connected(arm, connect, zenoh_file) as client:
        ask(client, arm, "cancel", {}, as_json)


def stop(arm: ArmName, connect: Connect = ENDPOINT, zenoh_file: ZenohFile = None, as_json: AsJson = False) -> None:
    """Stop the arm: it holds and accepts no motion until reset. No substitute for a switch that cuts the power."""
    with connected(arm, connect, zenoh_file) as client:
        ask(client, arm, "stop", {}, as_json)


def reset(arm: ArmName, connect: Connect = ENDPOINT, zenoh_file: ZenohFile = None, as_json: AsJson = False) -> None:
    """Leave a stop or a fault. Nothing moves."""
    with connected(arm, connect, zenoh_file) as client:
        ask(client, arm, "reset", {}, as_json)


def jog(
    arm: ArmName,
    changes: Annotated[list[str], typer.Argument(metavar="ACTUATOR=STATE", help=SWITCHES, show_default=False)],
    connect: Connect = ENDPOINT,
    zenoh_file: ZenohFile = None,
    as_json: AsJson = False,
) -> None:
    """Switch single actuators, even if their states form no configuration. The arm moves."""
    actuators = dict[str, str]()
    for change in changes:
        actuator, _, state = change.partition("=")
        if not actuator.isprintable() or state not in STATES:
            form = "an actuator, =, and contracted or extended are needed, as in 5.left=extended"
            raise InputFaults(Path("jog"), [f"{change!r}: {form}"])
        if actuator in actuators:
            raise InputFaults(Path("jog"), [f"{change!r}: {actuator} is given twice"])
        actuators[actuator] = state
    with connected(arm, connect, zenoh_file) as client:
        ask(client, arm, "jog", {"actuators": actuators}, as_json)


def degrade(
    arm: ArmName,
    changes: Annotated[list[str], typer.Argument(metavar="ACTUATOR=STATE", help=LOCKS, show_default=False)],
    connect: Connect = ENDPOINT,
    zenoh_file: ZenohFile = None,
    as_json: AsJson = False,
) -> None:
    """Lock actuators that are stuck, or unlock them. Nothing moves."""
    payloads = [parse_lock(change) for change in changes]
    with connected(arm, connect, zenoh_file) as client:
        for payload in payloads:
            ask(client, arm, "degrade", payload, as_json)
            time.sleep(PAUSE)


def lock(
    arm: ArmName,
    changes: Annotated[list[str], typer.Argument(metavar="ACTUATOR=STATE", help=LOCKS, show_default=False)],
    connect: Connect = ENDPOINT,
    zenoh_file: ZenohFile = None,
    as_json: AsJson = False,
) -> None:
    """Lock actuators in a state, or unlock them with `free`; the same as `degrade`. Nothing moves."""
    degrade(arm, changes, connect, zenoh_file, as_json)


def obstacles(
    arm: ArmName,
    file: Annotated[Path | None, typer.Argument(metavar="REGIONS.yaml", help=REGIONS, show_default=False)] = None,
    none: Annotated[bool, typer.Option("--none", help="Remove all obstacles that were sent.")] = False,
    connect: Connect = ENDPOINT,
    zenoh_file: ZenohFile = None,
    as_json: AsJson = False,
) -> None:
    """Replace the obstacles that were sent before; those of the arm's file remain. Nothing moves."""
    if (file is None) != none:
        raise InputFaults(Path("obstacles"), ["give either a file of regions or --none"])
    payload: dict[str, Any] = {"regions": []} if file is None else read_payload(file, "regions", "regions")
    with connected(arm, connect, zenoh_file) as client:
        ask(client, arm, "obstacles", payload, as_json)


def parse_lock(change: str) -> dict[str, Any]:
    """Returns the payload of `degrade` for "ACTUATOR=STATE".

    Raises:
        InputFaults: the text has another form.
    """
    actuator, _, state = change.partition("=")
    states = {**{word: k for k, word in enumerate(STATES)}, "free": None}
    if not actuator.isprintable() or state not in states:
        form = f"an actuator, =, and one of {', '.join(states)} are needed, as in 5.left=contracted"
        raise InputFaults(Path("degrade"), [f"{change!r}: {form}"])
    return {"actuator": actuator, "state": states[state]}
