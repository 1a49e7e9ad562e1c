"""Commands on single actuators of a running arm: jog switches them, lock locks them."""

from __future__ import annotations

import queue
import time
from pathlib import Path
from typing import Any

import typer

from hyperbit.controller.armfile.locks import STATES
from hyperbit.controller.armfile.strict import InputFaults
from hyperbit.controller.commands import ENDPOINT
from hyperbit.controller.commands.arguments import ArmName, AsJson, Connect, Locks, Switches, Wait, ZenohFile
from hyperbit.controller.commands.common import CommandFailed, counted, print_json, refusal
from hyperbit.controller.commands.connection import ask, connected, named
from hyperbit.controller.decoding.decoding import convert
from hyperbit.controller.messages.goals import Result
from hyperbit.controller.messages.state import State
from hyperbit.controller.network.endpoints import START

PAUSE = 0.002  # [s]; deploy/zenoh-tls.json5 drops a second request of a kind within a millisecond
SILENCE = 10.0  # [s] without a state, after which the daemon is lost


def jog(
    arm: ArmName,
    changes: Switches,
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

    def show(answer: dict[str, Any]) -> None:
        if as_json:
            print_json(answer)
        elif answer.get("accepted"):
            typer.echo(answer["message"])

    with connected(arm, connect, zenoh_file) as client:
        if not wait:
            ask(client, named(arm, connect, zenoh_file), "jog", {"actuators": actuators}, as_json)
            return
        result = client.run({"actuators": actuators}, show, key="jog")
    if as_json and "status" in result:
        print_json(result)
    if result.get("code") != 0:
        raise refusal(result, named(arm, connect, zenoh_file))
    if not as_json:
        told = convert(result, Result)
        times = [f"{travel.actuator} in {travel.seconds * 1e3:.0f} ms" for travel in told.travels or ()]
        typer.echo(f"{told.message}, {counted(told.switches)}" + (f": {', '.join(times)}" if times else ""))


def lock(
    arm: ArmName,
    changes: Locks,
    wait: Wait = True,
    connect: Connect = ENDPOINT,
    zenoh_file: ZenohFile = None,
    as_json: AsJson = False,
) -> None:
    """Lock actuators that are stuck in a state, or unlock them with `free`. Nothing moves."""
    wanted = [parse_lock(change) for change in changes]
    states: queue.SimpleQueue[dict[str, Any]] = queue.SimpleQueue()
    with connected(arm, connect, zenoh_file) as client, client.subscribe("state", states.put):
        for actuator, state in wanted:
            ask(client, named(arm, connect, zenoh_file), "degrade", {"actuator": actuator, "state": state}, as_json)
            time.sleep(PAUSE)
        if wait:
            found = locked_state(states, dict(wanted))
            if found.mode == "fault" and not as_json:
                typer.echo(f"the arm is in fault: {found.reason}")


def locked_state(states: queue.SimpleQueue[dict[str, Any]], wanted: dict[str, int | None]) -> State:
    """Returns the first state with these locks, None: free, in which the planner's tables are built."""
    while True:
        try:
            state = convert(states.get(timeout=SILENCE), State)
        except queue.Empty:
            raise CommandFailed("locked, but the daemon does not publish its state", START) from None
        locks = {lock.actuator: lock.state for lock in state.degraded}
        if state.mode != "starting" and all(locks.get(name) == lock for name, lock in wanted.items()):
            return state


def parse_lock(change: str) -> tuple[str, int | None]:
    """Returns actuator and state of "ACTUATOR=STATE"; None: free."""
    actuator, _, state = change.partition("=")
    states = {**{word: k for k, word in enumerate(STATES)}, "free": None}
    if not actuator.isprintable() or state not in states:
        form = f"an actuator, =, and one of {', '.join(states)} are needed, as in 5.left=contracted"
        raise InputFaults(Path("lock"), [f"{change!r}: {form}"])
    return actuator, states[state]
