"""The command `list`: the arms that have a running daemon."""

from __future__ import annotations

import queue
import time
from typing import TYPE_CHECKING, Any

import typer

from controller.commands.common import ENDPOINT, AsJson, CommandFailed, Connect, ZenohFile, print_json
from controller.commands.connection import START, arms_alive, open_session

if TYPE_CHECKING:
    import zenoh

STATE_TIMEOUT = 2.0  # [s] for the states of all arms; each arm publishes several a second


def list_(connect: Connect = ENDPOINT, zenoh_file: ZenohFile = None, as_json: AsJson = False) -> None:
    """List the arms that have a daemon, each with its mode, goal and faults."""
    from controller.network.client import decoded

    news: queue.SimpleQueue[tuple[str, dict[str, Any]]] = queue.SimpleQueue()

    def hear(sample: zenoh.Sample) -> None:
        news.put((str(sample.key_expr).split("/")[1], decoded(sample)))

    with open_session(connect, zenoh_file) as session, session.declare_subscriber("hyperbit/*/state", hear):
        names = arms_alive(session)
        states, until = dict[str, dict[str, Any]](), time.monotonic() + STATE_TIMEOUT
        while set(names) - set(states):
            try:
                name, state = news.get(timeout=max(until - time.monotonic(), 0.0))
            except queue.Empty:
                break
            states[name] = state
    if not names:
        raise CommandFailed(f"no arm at {zenoh_file or connect}", START)
    for name in names:
        print_arm(name, states.get(name), as_json)


def print_arm(name: str, state: dict[str, Any] | None, as_json: bool) -> None:
    """Prints one arm; `state` is None if none came."""
    if as_json:
        fields = ("mode", "reason", "simulated", "goal", "faults")
        print_json({"name": name, **{field: state and state.get(field) for field in fields}})
        return
    if state is None:
        typer.echo(f"{name}: alive, but it publishes no state")
        return
    simulated = " (simulated)" if state.get("simulated") else ""
    typer.echo(f"{name}{simulated}: {state['mode']}, {'; '.join(reason_and_faults(state))}")


def reason_and_faults(state: dict[str, Any]) -> list[str]:
    """Returns the reason of a state's mode, then its faults with their codes; a fault that is the reason comes once."""
    faults = {f"{fault['code']}: {fault['message']}": fault["message"] for fault in state["faults"]}
    reason = next((text for text, message in faults.items() if message == state["reason"]), state["reason"])
    return list(dict.fromkeys([reason, *faults]))
