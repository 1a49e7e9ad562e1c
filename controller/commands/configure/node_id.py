"""The command `node-id`: sets a board's node id and bit rate by LSS (CiA 305)."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from hyperbit.controller.armfile.strict import InputFaults
from hyperbit.controller.commands.arguments import AsJson, Bitrate, Channel, Interface
from hyperbit.controller.commands.common import CommandFailed, print_json
from hyperbit.controller.commands.configure.probe import command_for_rate, session_on
from hyperbit.drivers.canopen.tools.lss import BIT_TIMINGS, Lss, LssIdentity, LssRefused
from hyperbit.drivers.canopen.tools.probe import probe_bus
from hyperbit.drivers.canopen.wiring import MASTER

NEW = f"The new node id, 1 to {MASTER - 1}."
RATE = "The new bit rate [bit/s]."
BOARD = "LssIdentity 1018h, VENDOR:PRODUCT:REVISION:SERIAL, as --list and `probe` print it. Default: the only board."
UNCONFIGURED = "Only list the boards that have no node id yet."


def node_id(
    channel: Channel,
    new: Annotated[int | None, typer.Argument(metavar="NODE", help=NEW, show_default=False)] = None,
    new_bitrate: Annotated[int | None, typer.Option(help=RATE, show_default=False)] = None,
    board: Annotated[str | None, typer.Option(help=BOARD, show_default=False)] = None,
    list_: Annotated[bool, typer.Option("--list", help=UNCONFIGURED)] = False,
    interface: Interface = "socketcan",
    bitrate: Bitrate = None,
    as_json: AsJson = False,
) -> None:
    """Set and store a board's node id and bit rate by LSS; they apply from the next power-on.

    Connect a single board, or name one by --board. No executor may use the bus.

    Example: hyperbit node-id can0 5 --board 0x21:0x2f1:0x10000:0x1a2b
    """
    check_options(new, new_bitrate, list_=list_)
    identity = None if board is None else parse_identity(board)
    try:
        with session_on(channel, interface, bitrate) as session:
            nodes = [node.node for node in probe_bus(session, channel, in_full=False)]
            lss = Lss(session, channel)
            if list_:
                show(lss.unconfigured(), channel, as_json)
                return
            if identity is None and len(nodes) > 1:
                listed = ", ".join(map(str, nodes))
                raise CommandFailed(f"nodes {listed} are on {channel}: connect a single board, or name one by --board")
            try:
                selected, old = lss.select(identity)
                if new is not None and new != old and new in nodes:
                    raise CommandFailed(f"node id {new} is taken on {channel}; see its board: hyperbit probe {channel}")
                lss.configure(old, new, new_bitrate)
            finally:
                lss.release()
    except LssRefused as error:
        raise CommandFailed(f"{channel}: {error}") from None
    if as_json:
        print_json({"identity": str(selected), "before": old, "node": new or old, "bitrate": new_bitrate})
        return
    stored = [] if new is None else [f"node id {new} (before: {'none' if old > MASTER else old})"]
    stored += [] if new_bitrate is None else [f"{new_bitrate} bit/s"]
    typer.echo(f"board {selected}: stored {' and '.join(stored)}")
    named = interface != "socketcan"
    rate = new_bitrate or bitrate
    if rate and not named:
        typer.echo(f"switch its supply off and on, and the bus to its bit rate: {command_for_rate(channel, rate)}")
    more = (f" --bitrate {rate}" if rate else "") + f" --interface {interface}" if named else ""
    first = "then" if rate and not named else "switch its supply off and on, then"
    typer.echo(f"{first}: hyperbit probe {channel}{more}")


def check_options(node: int | None, bitrate: int | None, *, list_: bool) -> None:
    if list_ == (node is not None or bitrate is not None):
        raise InputFaults(Path("node-id"), ["give a node id, --new-bitrate or both; or --list alone"])
    if node is not None and not 1 <= node < MASTER:
        form = f"a board's node id is 1 to {MASTER - 1} ({MASTER} is the master's)"
        raise InputFaults(Path("node-id"), [f"{node}: {form}"])
    if bitrate is not None and bitrate not in BIT_TIMINGS:
        rates = ", ".join(map(str, sorted(BIT_TIMINGS)))
        raise InputFaults(Path("--new-bitrate"), [f"{bitrate} is not one of {rates}"])


def parse_identity(text: str) -> LssIdentity:
    """Parses an identity, "VENDOR:PRODUCT:REVISION:SERIAL"."""
    try:
        numbers = [int(part, 0) for part in text.split(":")]
    except ValueError:
        numbers = []
    if len(numbers) != 4 or not all(0 <= number < 1 << 32 for number in numbers):
        form = "four numbers are needed, VENDOR:PRODUCT:REVISION:SERIAL, such as 0x21:0x2f1:0x10000:0x1a2b"
        raise InputFaults(Path("--board"), [f"{text!r}: {form}"])
    return LssIdentity(*numbers)


def show(found: list[LssIdentity], channel: str, as_json: bool) -> None:
    for one in found:
        if as_json:
            print_json(one._asdict())
        else:
            typer.echo(f"{one}  hyperbit node-id {channel} NODE --board {one}")
    if not found and not as_json:
        typer.echo(f"each board on {channel} has a node id; list them: hyperbit probe {channel}")
