"""The command `fleet`: all arms of a network in one table, also below namespaces."""

from __future__ import annotations

import contextlib
import json
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NoReturn

import typer
from msgspec import to_builtins
from rich.console import Group, RenderableType
from rich.live import Live
from rich.table import Table
from rich.text import Text

from hyperbit.controller.armfile.strict import InputFaults
from hyperbit.controller.commands import ENDPOINT, common
from hyperbit.controller.commands.arguments import AsJson, Connect, ZenohFile
from hyperbit.controller.commands.common import CommandFailed, print_json, print_table, results_table
from hyperbit.controller.commands.connection import open_session, zenoh_config
from hyperbit.controller.commands.use.watch import COLOURS, reason_and_faults
from hyperbit.controller.messages.state import State
from hyperbit.controller.network.endpoints import START

if TYPE_CHECKING:
    from hyperbit.controller.network.fleet import ArmAddress, ArmStatus, Fleet

COLUMNS = ("namespace", "arm", "host", "version", "mode", "goal", "faults")
FOLLOW = "In a pipe or with --json: print a line for each change until Ctrl-C, instead of all arms once."
ONCE = "Print all arms once also in a terminal."
STATE_TIMEOUT = 2.0  # [s] for the states of all arms; each arm publishes several a second
FRAME, POLL = 0.25, 0.05  # [s] between two tables, and between two looks for changes


def fleet(
    follow: Annotated[bool, typer.Option("--follow", help=FOLLOW)] = False,
    once: Annotated[bool, typer.Option("--once", help=ONCE)] = False,
    connect: Connect = ENDPOINT,
    zenoh_file: ZenohFile = None,
    as_json: AsJson = False,
) -> None:
    """Show all arms of a network until Ctrl-C, also below namespaces; in a pipe or with --json print them once."""
    if follow and once:
        raise InputFaults(Path("fleet"), ["give either --follow or --once"])
    if follow or (common.console.is_terminal and not as_json and not once):
        follow_arms(connect, zenoh_file, as_json=as_json)
        return
    from hyperbit.controller.network.fleet import LIST_TIMEOUT, Fleet, alive

    with (
        open_session(connect, zenoh_file) as session,
        contextlib.closing(Fleet(session, alive(session, timeout=LIST_TIMEOUT))) as found,
    ):
        arms = [arm for arm in found.wait_for_states(STATE_TIMEOUT, described=True) if arm.gone_at is None]
    if not arms:
        raise CommandFailed(f"no arm at {zenoh_file or connect}", START)
    if as_json:
        for arm in arms:
            print_json(fields_of(arm))
    else:
        print_table(filled(results_table(*COLUMNS), arms))


def follow_arms(connect: str, zenoh_file: Path | None, *, as_json: bool) -> None:
    """Shows the arms until Ctrl-C: in a terminal a table, otherwise a line for each change."""
    from hyperbit.controller.network.fleet import Fleet
    from hyperbit.controller.network.session import reachable

    with (
        open_session(connect, zenoh_file) as session,
        contextlib.closing(Fleet(session)) as arms,
        contextlib.suppress(KeyboardInterrupt),
    ):
        where, connected = str(zenoh_file or connect), reachable(session, zenoh_config(zenoh_file, connect=connect))
        if as_json or not common.console.is_terminal:
            print_changes(arms, lambda: None if connected() else lost(where), as_json=as_json)
        with Live(console=common.console, auto_refresh=False) as live:
            while True:
                arms.ask()
                live.update(view_of(arms.arms(), where, connected=connected()), refresh=True)
                time.sleep(FRAME)


def print_changes(arms: Fleet, loss: Callable[[], str | None], *, as_json: bool) -> NoReturn:
    """Prints a line for each change of an arm, without an end.

    `loss` returns a message while the session has no connection: then nothing is known of any arm.
    """
    last: dict[ArmAddress, str] = {}
    told = None
    while True:
        arms.ask()
        known = arms.arms()
        if (message := loss()) is not None:
            known = []
            if message != told:
                typer.echo(message, err=True)
        told = message
        for arm in known:
            line = json.dumps(fields_of(arm)) if as_json else line_of_arm(arm)
            if arm.is_new or line == last.get(arm.address):
                continue
            last[arm.address] = line
            sys.stdout.write(f"{line}\n" if as_json else f"{clock()} {line}\n")
            sys.stdout.flush()
        time.sleep(POLL)


def lost(where: str) -> str:
    """Returns the message on a lost connection; Zenoh connects again by itself."""
    return f"no connection to {where}: the arms may be alive; trying again"


def fields_of(arm: ArmStatus) -> dict[str, Any]:
    """Returns an arm as the fields of a line of JSON; those of the state are null if no state came."""
    names = ("mode", "reason", "simulated", "goal", "faults")
    state = {name: None if arm.state is None else to_builtins(getattr(arm.state, name)) for name in names}
    daemon = {"host": arm.host, "version": arm.version}
    alive = {"alive": arm.gone_at is None, "gone_at": arm.gone_at, "old": arm.is_old}
    return {"name": arm.address.name, "namespace": arm.address.namespace, **state, **daemon, **alive}


def line_of_arm(arm: ArmStatus) -> str:
    if arm.gone_at is not None:
        return f"{arm.address}: gone"
    if arm.state is None:
        return f"{arm.address}: alive, but it publishes no state" + (" that can be read" if arm.age is not None else "")
    simulated = " (simulated)" if arm.state.simulated else ""
    old = "publishes no state any more; the last was: " if arm.is_old else ""
    return f"{arm.address}{simulated}: {old}{arm.state.mode}, {'; '.join(reason_and_faults(arm.state))}"


def view_of(arms: Sequence[ArmStatus], where: str, *, connected: bool) -> RenderableType:
    """Returns the table of a terminal; `where`: endpoint or Zenoh file, for messages."""
    if not connected:
        return Group(Text(lost(where), style="red"), filled(terminal_table(), arms, "not reached"))
    if not arms:
        return Text(f"no arm at {where} yet")
    alive = [arm for arm in arms if arm.gone_at is None]
    faulty = sum(bool(arm.state and arm.state.faults) for arm in alive)
    summary = f"{len(alive)} alive, {len(arms) - len(alive)} gone, {faulty} with faults"
    return Group(Text(summary), filled(terminal_table(), arms))  # a low terminal cuts the last rows


def terminal_table() -> Table:
    """Returns an empty table; the faults wrap on a narrow terminal."""
    table = results_table(*COLUMNS)
    table.columns[-1].no_wrap = False
    return table


def filled(table: Table, arms: Sequence[ArmStatus], absence: str = "gone") -> Table:
    """Adds a row for each arm; returns the table. `absence` is the mode of an arm without liveliness token."""
    for arm in arms:
        state = arm.state or State("")
        name = f"{arm.address.name} (simulated)" if state.simulated else arm.address.name
        faults = "; ".join(f"{fault.code}: {fault.message}" for fault in state.faults)
        cells = (arm.address.namespace, name, arm.host or "", arm.version or "")
        dim = "dim" if arm.gone_at is not None or arm.is_old else ""
        table.add_row(*map(Text, cells), mode_of(arm, absence), Text(state.goal or ""), Text(faults), style=dim)
    return table


def mode_of(arm: ArmStatus, absence: str) -> Text:
    if arm.gone_at is not None:
        return Text(f"{absence} since {clock(arm.gone_at)}", style="red")
    if arm.state is None:
        return Text("" if arm.is_new else "no state", style="yellow")
    if arm.is_old:
        return Text(f"{arm.state.mode} {arm.age:.0f} s ago", style="yellow")
    return Text(arm.state.mode, style=COLOURS.get(arm.state.mode, ""))


def clock(stamp: float | None = None) -> str:
    return time.strftime("%H:%M:%S", time.localtime(stamp))
