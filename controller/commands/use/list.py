"""The command `list`: the arms that have a running daemon."""

from __future__ import annotations

import contextlib
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from hyperbit.controller.commands.arguments import AsJson, Connect, ZenohFile
from hyperbit.controller.commands.common import CommandFailed, print_json
from hyperbit.controller.commands.connection import ENDPOINT, START, open_session

if TYPE_CHECKING:
    from hyperbit.controller.network.fleet import ArmStatus

STATE_TIMEOUT = 2.0  # [s] for the states of all arms; each arm publishes several a second


def list_(connect: Connect = ENDPOINT, zenoh_file: ZenohFile = None, as_json: AsJson = False) -> None:
    """List the arms that have a daemon, each with its mode, goal and faults."""
    for arm in arms_now(connect, zenoh_file):
        if as_json:
            print_json(fields_of(arm))
        else:
            typer.echo(line_of_arm(arm))


def arms_now(connect: str, zenoh_file: Path | None, *, described: bool = False) -> list[ArmStatus]:
    """Returns the arms that are alive, each with its state, and if `described` with host and version.

    Raises:
        CommandFailed: no arm is alive.
    """
    from hyperbit.controller.network.fleet import LIST_TIMEOUT, Fleet, alive

    with (
        open_session(connect, zenoh_file) as session,
        contextlib.closing(Fleet(session, alive(session, timeout=LIST_TIMEOUT))) as fleet,
    ):
        arms = [arm for arm in fleet.wait_for_states(STATE_TIMEOUT, described=described) if arm.gone_at is None]
    if not arms:
        raise CommandFailed(f"no arm at {zenoh_file or connect}", START)
    return arms


def fields_of(arm: ArmStatus) -> dict[str, Any]:
    """Returns an arm as the fields of a line of JSON; those of the state are null if no state came."""
    state = {field: arm.state and arm.state[field] for field in ("mode", "reason", "simulated", "goal", "faults")}
    return {"name": arm.address.name, "namespace": arm.address.namespace, **state}


def line_of_arm(arm: ArmStatus) -> str:
    """Returns an arm in one line."""
    if arm.gone_at is not None:
        return f"{arm.address}: gone"
    if arm.state is None:
        return f"{arm.address}: alive, but it publishes no state" + (" that can be read" if arm.age is not None else "")
    simulated = " (simulated)" if arm.state["simulated"] else ""
    old = "publishes no state any more; the last was: " if arm.is_old else ""
    return f"{arm.address}{simulated}: {old}{arm.state['mode']}, {'; '.join(reason_and_faults(arm.state))}"


def reason_and_faults(state: dict[str, Any]) -> list[str]:
    """Returns the reason of a state's mode, then its faults with their codes; a fault that is the reason comes once."""
    faults = {f"{fault['code']}: {fault['message']}": fault["message"] for fault in state["faults"]}
    reason = next((text for text, message in faults.items() if message == state["reason"]), state["reason"])
    return list(dict.fromkeys([reason, *faults]))
