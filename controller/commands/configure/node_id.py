"""The command `node-id`: sets a board's node id and bit rate by LSS (CiA 305)."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, NamedTuple

import typer

from hyperbit.controller.armfile.strict import InputFaults
from hyperbit.controller.commands.arguments import AsJson
from hyperbit.controller.commands.common import CommandFailed, print_json
from hyperbit.controller.commands.configure.probe import Bitrate, Channel, Interface, session_on
from hyperbit.drivers.canopen.tools.lss import BIT_TIMINGS, Lss, LssIdentity, LssRefused
from hyperbit.drivers.canopen.tools.probe import probe_bus
from hyperbit.drivers.canopen.wiring import MASTER, BusWiring

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
    bitrate: Bitrate = 1_000_000,
    as_json: AsJson = False,
) -> None:
    """Set and store a board's node id and bit rate by LSS; they apply from the next power-on.

    Connect a single board, or name one by --board. No executor may use the bus.

    Example: hyperbit node-id can0 5 --board 0x21:0x2f1:0x10000:0x1a2b
    """
    wanted = NewSettings(new, new_bitrate)
    check_options(wanted, list_=list_)
    identity = None if board is None else parse_identity(board)
    bus = BusWiring(name=channel, interface=interface, channel=channel, bitrate=bitrate)
    try:
        with session_on(bus) as session:
            nodes = [node.node for node in probe_bus(session, channel, in_full=False)]
            lss = Lss(session, channel)
            if list_:
                show(lss.unconfigured(), channel, as_json)
                return
            if identity is None:
                check_single(nodes, channel)
            selected, old = store(lss, identity, wanted, nodes, channel)
    except LssRefused as error:
        raise CommandFailed(f"{channel}: {error}") from None
    if as_json:
        print_json({"identity": str(selected), "before": old, "node": new or old, "bitrate": new_bitrate})
    else:
        print_stored(selected, old, wanted, bus)


class NewSettings(NamedTuple):
    """The new node id and bit rate [bit/s] of a board; None: unchanged."""

    node: int | None
    bitrate: int | None


def check_options(wanted: NewSettings, *, list_: bool) -> None:
    """Checks which options are given together, and the range of node id and bit rate.

    Raises:
        InputFaults: an option is wrong.
    """
    if list_ == (wanted != (None, None)):
        raise InputFaults(Path("node-id"), ["give a node id, --new-bitrate or both; or --list alone"])
    if wanted.node is not None and not 1 <= wanted.node < MASTER:
        form = f"a board's node id is 1 to {MASTER - 1} ({MASTER} is the master's)"
        raise InputFaults(Path("node-id"), [f"{wanted.node}: {form}"])
    if wanted.bitrate is not None and wanted.bitrate not in BIT_TIMINGS:
        rates = ", ".join(map(str, sorted(BIT_TIMINGS)))
        raise InputFaults(Path("--new-bitrate"), [f"{wanted.bitrate} is not one of {rates}"])


def check_single(nodes: list[int], channel: str) -> None:
    """Checks that at most one board with a node id is on a bus.

    Raises:
        CommandFailed: there are more.
    """
    if len(nodes) > 1:
        listed = ", ".join(map(str, nodes))
        raise CommandFailed(f"nodes {listed} are on {channel}: connect a single board, or name one by --board")


def store(
    lss: Lss, identity: LssIdentity | None, wanted: NewSettings, nodes: list[int], channel: str
) -> tuple[LssIdentity, int]:
    """Stores the new settings of a board, and releases it.

    Args:
        lss: of the bus.
        identity: of the board; None: the only board.
        wanted: the new settings.
        nodes: node ids on the bus.
        channel: of the bus, for messages.

    Returns:
        The board's identity, and its node id before.

    Raises:
        CommandFailed: another board has the node id.
    """
    try:
        selected, old = lss.select(identity)
        if wanted.node is not None and wanted.node != old:
            refuse_taken(nodes, wanted.node, channel)
        lss.configure(old, wanted.node, wanted.bitrate)
    finally:
        lss.release()
    return selected, old


def print_stored(selected: LssIdentity, old: int, wanted: NewSettings, bus: BusWiring) -> None:
    """Prints what was stored, and the next step."""
    before = "none" if old > MASTER else str(old)
    stored = [f"node id {wanted.node} (before: {before})"] if wanted.node is not None else []
    stored += [f"{wanted.bitrate} bit/s"] if wanted.bitrate is not None else []
    typer.echo(f"board {selected}: stored {' and '.join(stored)}")
    named = bus.interface != "socketcan"
    rate = f" --bitrate {wanted.bitrate or bus.bitrate}" if wanted.bitrate or named else ""
    interface = f" --interface {bus.interface}" if named else ""
    typer.echo(f"switch its supply off and on, then: hyperbit probe {bus.channel}{rate}{interface}")


def parse_identity(text: str) -> LssIdentity:
    """Parses an identity, "VENDOR:PRODUCT:REVISION:SERIAL".

    Raises:
        InputFaults: the text has another form.
    """
    try:
        numbers = [int(part, 0) for part in text.split(":")]
    except ValueError:
        numbers = []
    if len(numbers) != 4 or not all(0 <= number < 1 << 32 for number in numbers):
        form = "four numbers are needed, VENDOR:PRODUCT:REVISION:SERIAL, such as 0x21:0x2f1:0x10000:0x1a2b"
        raise InputFaults(Path("--board"), [f"{text!r}: {form}"])
    return LssIdentity(*numbers)


def refuse_taken(nodes: list[int], new: int, channel: str) -> None:
    """Refuses a node id that another board has.

    Raises:
        CommandFailed: another board has it.
    """
    if new in nodes:
        raise CommandFailed(f"node id {new} is taken on {channel}; see its board: hyperbit probe {channel}")


def show(found: list[LssIdentity], channel: str, as_json: bool) -> None:
    """Prints the boards without a node id."""
    for one in found:
        if as_json:
            print_json(one._asdict())
        else:
            typer.echo(f"{one}  hyperbit node-id {channel} NODE --board {one}")
    if not found and not as_json:
        typer.echo(f"each board on {channel} has a node id; list them: hyperbit probe {channel}")
