"""The command `node-id`: sets a board's node id and bit rate by LSS (CiA 305)."""

from __future__ import annotations

import contextlib
import signal
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated

import typer

from controller.armfile.strict import InputFaults
from controller.commands.common import AsJson, CommandFailed, print_json
from controller.commands.configure.probe import Bitrate, Channel, Interface, surveyed
from drivers.canopen.faults import BusError
from drivers.canopen.tools.lss import BIT_TIMINGS, Identity, Lss, Refused, over
from drivers.canopen.tools.survey import Survey
from drivers.canopen.wire.bus import CanBus
from drivers.canopen.wiring import MASTER, BusSettings

NEW = f"The new node id, 1 to {MASTER - 1}."
RATE = "The new bit rate [bit/s]."
BOARD = "Identity 1018h, VENDOR:PRODUCT:REVISION:SERIAL, as --list and `probe` print it. Default: the only board."
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
    if list_ == (new is not None or new_bitrate is not None):
        raise InputFaults(Path("node-id"), ["give a node id, --new-bitrate or both; or --list alone"])
    if new is not None and not 1 <= new < MASTER:
        raise InputFaults(
            Path("node-id"), [f"{new}: a board's node id is 1 to {MASTER - 1} ({MASTER} is the master's)"]
        )
    if new_bitrate is not None and new_bitrate not in BIT_TIMINGS:
        rates = ", ".join(map(str, sorted(BIT_TIMINGS)))
        raise InputFaults(Path("--new-bitrate"), [f"{new_bitrate} is not one of {rates}"])
    identity = None if board is None else parse_identity(board)
    present = surveyed(channel, interface, bitrate, in_full=False)
    with opened(BusSettings(channel, interface, channel, bitrate)) as lss:
        if list_:
            show(lss.unconfigured(), channel, as_json)
            return
        if identity is None and len(present.found) > 1:
            nodes = ", ".join(str(node.node) for node in present.found)
            raise CommandFailed(f"nodes {nodes} are on {channel}: connect a single board, or name one by --board")
        try:
            selected, old = lss.select(identity)
            if new is not None and new != old:
                refuse_taken(present, new, channel)
            lss.configure(old, new, new_bitrate)
        finally:
            lss.release()
    if as_json:
        print_json({"identity": str(selected), "before": old, "node": new or old, "bitrate": new_bitrate})
        return
    before = "none" if old > MASTER else str(old)
    stored = [f"node id {new} (before: {before})"] if new is not None else []
    stored += [f"{new_bitrate} bit/s"] if new_bitrate is not None else []
    typer.echo(f"board {selected}: stored {' and '.join(stored)}")
    rate = f" --bitrate {new_bitrate or bitrate}" if new_bitrate or interface != "socketcan" else ""
    hint = f"switch its supply off and on, then: hyperbit probe {channel}{rate}"
    typer.echo(hint + (f" --interface {interface}" if interface != "socketcan" else ""))


def parse_identity(text: str) -> Identity:
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
    return Identity(*numbers)


def refuse_taken(present: Survey, new: int, channel: str) -> None:
    """Refuses a node id that another board has.

    Raises:
        CommandFailed: another board has it.
    """
    if new in [node.node for node in present.found]:
        raise CommandFailed(f"node id {new} is taken on {channel}; see its board: hyperbit probe {channel}")


def show(found: list[Identity], channel: str, as_json: bool) -> None:
    """Prints the boards without a node id."""
    for one in found:
        if as_json:
            print_json(one._asdict())
        else:
            typer.echo(f"{one}  hyperbit node-id {channel} NODE --board {one}")
    if not found and not as_json:
        typer.echo(f"each board on {channel} has a node id; list them: hyperbit probe {channel}")


@contextlib.contextmanager
def opened(settings: BusSettings) -> Iterator[Lss]:
    """Opens a bus for LSS.

    Raises:
        CommandFailed: the bus cannot be opened, or a board refuses a request.
    """
    bus = CanBus(settings)
    before = signal.signal(signal.SIGTERM, lambda *_: sys.exit(128 + signal.SIGTERM))  # the board is released first
    try:
        bus.open()
        yield Lss(over(bus))
    except (BusError, Refused) as error:
        raise CommandFailed(f"{settings.name}: {error}") from None
    finally:
        bus.close()
        signal.signal(signal.SIGTERM, before)
