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
from rich.console import Group, RenderableType
from rich.live import Live
from rich.table import Table
from rich.text import Text

from hyperbit.controller.commands import common
from hyperbit.controller.commands.arguments import AsJson, Connect, ZenohFile
from hyperbit.controller.commands.common import print_json, print_table, results_table
from hyperbit.controller.commands.connection import ENDPOINT, client_config, open_session
from hyperbit.controller.commands.use.list import arms_now, fields_of, line_of_arm
from hyperbit.controller.commands.use.watch import COLOURS

if TYPE_CHECKING:
    from hyperbit.controller.network.fleet import ArmAddress, ArmStatus, Fleet

COLUMNS = ("namespace", "arm", "host", "version", "mode", "goal", "faults")
FOLLOW = "In a pipe or with --json: print a line for each change until Ctrl-C, instead of all arms once."
FRAME, POLL = 0.25, 0.05  # [s] between two tables, and between two looks for changes


def fleet(
    follow: Annotated[bool, typer.Option("--follow", help=FOLLOW)] = False,
    connect: Connect = ENDPOINT,
    zenoh_file: ZenohFile = None,
    as_json: AsJson = False,
) -> None:
    """Show all arms of a network until Ctrl-C, also below namespaces; in a pipe or with --json print them once."""
    if follow or (common.console.is_terminal and not as_json):
        follow_arms(connect, zenoh_file, as_json=as_json)
        return
    arms = arms_now(connect, zenoh_file, described=True)
    if as_json:
        for arm in arms:
            print_json(all_fields(arm))
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
        where, connected = str(zenoh_file or connect), reachable(session, client_config(connect, zenoh_file))
        if as_json or not common.console.is_terminal:
            print_changes(arms, lambda: None if connected() else lost(where), as_json=as_json)
        with Live(console=common.console, auto_refresh=False) as live:
            while True:
                arms.ask()
                live.update(view_of(arms.arms(), where, connected=connected()), refresh=True)
                time.sleep(FRAME)


def print_changes(arms: Fleet, loss: Callable[[], str | None], *, as_json: bool) -> NoReturn:
    """Prints a line for each change of an arm, without an end.

    Args:
        arms: all arms.
        loss: returns a message while the session has no connection: then nothing is known of any arm.
        as_json: whether the lines are JSON.
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
            line = json.dumps(all_fields(arm)) if as_json else line_of_arm(arm)
            if arm.is_new or line == last.get(arm.address):
                continue
            last[arm.address] = line
            sys.stdout.write(f"{line}\n" if as_json else f"{clock()} {line}\n")
            sys.stdout.flush()
        time.sleep(POLL)


def lost(where: str) -> str:
    """Returns the message on a lost connection; Zenoh connects again by itself."""
    return f"no connection to {where}: the arms may be alive; trying again"


def all_fields(arm: ArmStatus) -> dict[str, Any]:
    """Returns an arm as the fields of a line of JSON: those of `list`, its daemon, and whether it is alive."""
    daemon = {"host": arm.host, "version": arm.version}
    return {**fields_of(arm), **daemon, "alive": arm.gone_at is None, "gone_at": arm.gone_at, "old": arm.is_old}


def view_of(arms: Sequence[ArmStatus], where: str, *, connected: bool) -> RenderableType:
    """Returns the table of a terminal.

    Args:
        arms: all arms.
        where: endpoint or Zenoh file, for messages.
        connected: whether the session has a connection.
    """
    if not connected:
        return Group(Text(lost(where), style="red"), filled(terminal_table(), arms, "not reached"))
    if not arms:
        return Text(f"no arm at {where} yet")
    alive = [arm for arm in arms if arm.gone_at is None]
    faulty = sum(bool(arm.state and arm.state["faults"]) for arm in alive)
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
        state = arm.state or {"simulated": False, "goal": None, "faults": []}
        name = f"{arm.address.name} (simulated)" if state["simulated"] else arm.address.name
        faults = "; ".join(f"{fault['code']}: {fault['message']}" for fault in state["faults"])
        cells = (arm.address.namespace, name, arm.host or "", arm.version or "")
        dim = "dim" if arm.gone_at is not None or arm.is_old else ""
        table.add_row(*map(Text, cells), mode_of(arm, absence), Text(state["goal"] or ""), Text(faults), style=dim)
    return table


def mode_of(arm: ArmStatus, absence: str) -> Text:
    """Returns an arm's mode, or why it is not known."""
    if arm.gone_at is not None:
        return Text(f"{absence} since {clock(arm.gone_at)}", style="red")
    if arm.state is None:
        return Text("" if arm.is_new else "no state", style="yellow")
    if arm.is_old:
        return Text(f"{arm.state['mode']} {arm.age:.0f} s ago", style="yellow")
    return Text(arm.state["mode"], style=COLOURS.get(arm.state["mode"], ""))


def clock(stamp: float | None = None) -> str:
    """Returns a UNIX time as hours, minutes and seconds; None: now."""
    return time.strftime("%H:%M:%S", time.localtime(stamp))
