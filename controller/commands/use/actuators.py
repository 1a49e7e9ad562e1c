"""Commands on single actuators of a running arm: jog switches them, lock (or degrade) locks them."""

from __future__ import annotations

import queue
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from hyperbit.controller.armfile.locks import STATES
from hyperbit.controller.armfile.strict import InputFaults
from hyperbit.controller.commands.arguments import ArmName, AsJson, Connect, ZenohFile
from hyperbit.controller.commands.common import CommandFailed, print_json, refusal
from hyperbit.controller.commands.completion import complete_changes
from hyperbit.controller.commands.connection import ENDPOINT, START, ask, connected

if TYPE_CHECKING:
    from hyperbit.controller.network.client import Client

PAUSE = 0.002  # [s]; deploy/zenoh-tls.json5 drops a second request of a kind within a millisecond
SILENCE = 10.0  # [s] without a state, after which the daemon is lost
LOCKS = "Actuator and state, such as 5.left=contracted: contracted or extended locks it, free unlocks it."
SWITCHES = "Actuator and the state to switch it to, contracted or extended, such as 5.left=extended."

Switches = Annotated[
    list[str],
    typer.Argument(metavar="ACTUATOR=STATE", help=SWITCHES, show_default=False, autocompletion=complete_changes),
]
Locks = Annotated[
    list[str],
    typer.Argument(metavar="ACTUATOR=STATE", help=LOCKS, show_default=False, autocompletion=complete_changes),
]
Wait = Annotated[bool, typer.Option("--wait/--no-wait", help="Wait for the result, or for the answer only.")]


def jog(
    arm: ArmName,
    changes: Annotated[
        list[str],
        typer.Argument(metavar="ACTUATOR=STATE", help=SWITCHES, show_default=False, autocompletion=complete_changes),
    ],
    wait: Wait = True,
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
        if wait:
            follow_jog(client, arm, {"actuators": actuators}, as_json)
        else:
            ask(client, arm, "jog", {"actuators": actuators}, as_json)


def follow_jog(client: Client, arm: str, payload: dict[str, Any], as_json: bool) -> None:
    """Sends a jog, and prints its answer and result.

    Raises:
        CommandFailed: the daemon refused the jog, or an actuator did not arrive.
    """

    def show(answer: dict[str, Any]) -> None:
        if as_json:
            print_json(answer)
        elif answer.get("accepted"):
            typer.echo(answer["message"])

    result = client.run(payload, show, key="jog")
    if as_json and "status" in result:
        print_json(result)
    if result["code"] != 0:
        raise refusal(result, arm)
    if not as_json:
        times = [f"{travel['actuator']} in {travel['seconds'] * 1e3:.0f} ms" for travel in result["travels"]]
        count = f"{result['switches']} {'switch' if result['switches'] == 1 else 'switches'}"
        typer.echo(f"{result['message']}, {count}" + (f": {', '.join(times)}" if times else ""))


def degrade(
    arm: ArmName,
    changes: Annotated[
        list[str],
        typer.Argument(metavar="ACTUATOR=STATE", help=LOCKS, show_default=False, autocompletion=complete_changes),
    ],
    wait: Wait = True,
    connect: Connect = ENDPOINT,
    zenoh_file: ZenohFile = None,
    as_json: AsJson = False,
) -> None:
    """Lock actuators that are stuck, or unlock them. Nothing moves."""
    payloads = [parse_lock(change) for change in changes]
    states: queue.SimpleQueue[dict[str, Any]] = queue.SimpleQueue()
    with connected(arm, connect, zenoh_file) as client, client.subscribe("state", states.put):
        for payload in payloads:
            ask(client, arm, "degrade", payload, as_json)
            time.sleep(PAUSE)
        if wait:
            state = locked_state(states, {payload["actuator"]: payload["state"] for payload in payloads})
            if state["mode"] == "fault" and not as_json:
                typer.echo(f"the arm is in fault: {state['reason']}")


def locked_state(states: queue.SimpleQueue[dict[str, Any]], wanted: dict[str, int | None]) -> dict[str, Any]:
    """Returns the first state with these locks in which the planner's tables are built.

    Args:
        states: the arm's states.
        wanted: locked state of each actuator; None: it is free.

    Raises:
        CommandFailed: no state came for SILENCE.
    """
    while True:
        try:
            state = states.get(timeout=SILENCE)
        except queue.Empty:
            raise CommandFailed("locked, but the daemon does not publish its state", START) from None
        locks = {entry["actuator"]: entry["state"] for entry in state["degraded"]}
        if state["mode"] != "starting" and all(locks.get(name) == lock for name, lock in wanted.items()):
            return state


def lock(
    arm: ArmName,
    changes: Annotated[
        list[str],
        typer.Argument(metavar="ACTUATOR=STATE", help=LOCKS, show_default=False, autocompletion=complete_changes),
    ],
    wait: Wait = True,
    connect: Connect = ENDPOINT,
    zenoh_file: ZenohFile = None,
    as_json: AsJson = False,
) -> None:
    """Lock actuators in a state, or unlock them with `free`; the same as `degrade`. Nothing moves."""
    degrade(arm, changes, wait, connect, zenoh_file, as_json)


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
