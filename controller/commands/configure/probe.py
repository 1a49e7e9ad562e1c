"""The command `probe`: finds the nodes of a bus and prints their identity, mapping and settings."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

from hyperbit.controller.armfile.strict import InputFaults
from hyperbit.controller.commands import common
from hyperbit.controller.commands.arguments import AsJson, Bitrate, Channel, Interface
from hyperbit.controller.commands.common import CommandFailed, print_json
from hyperbit.controller.commands.configure.executor_absence import session_without_executor
from hyperbit.drivers.canopen.boot.pdo_state import PdoState, pdo_words
from hyperbit.drivers.canopen.pdo import carries
from hyperbit.drivers.canopen.sdo import objects
from hyperbit.drivers.canopen.tools.probe import TEXTS, ProbedNode, probe_bus
from hyperbit.drivers.canopen.tools.session import Session, stopped
from hyperbit.drivers.canopen.wire import cia301
from hyperbit.drivers.canopen.wire.cia301 import State
from hyperbit.drivers.canopen.wiring import MASTER, BusWiring

PROFILE = 0x191  # low word of 1000h of CiA 401
KINDS = {16: "digital inputs", 17: "digital outputs", 18: "analog inputs", 19: "analog outputs"}  # bits of 1000h
LOST = {0: "pre-operational", 1: "no change", 2: "stopped"}  # 1029h sub 1


def probe(
    channel: Channel,
    interface: Interface = "socketcan",
    bitrate: Bitrate = None,
    as_json: AsJson = False,
) -> None:
    """Find the nodes of a CAN bus and print their identity, mapping and settings; writes nothing.

    The command asks the node ids 1 to 127 in parallel and listens to heartbeats. It needs no arm's file, and a bus
    without an executor. With --json it prints a line for each node; send this line in if hyperbit does not know the
    board.
    """
    with session_on(channel, interface, bitrate) as session:
        found = probe_bus(session, channel)
    nodes = [node for node in found if node.node != MASTER or node.answers]
    for node in nodes:
        if as_json:
            print_json(as_mapping(node))
            continue
        common.console.print(f"{channel}/{node.node}")
        for what, text in rows(node, channel):
            common.console.print(f"  {what:<16} {text}")
    if not nodes:
        raise CommandFailed(f"no node answers on {channel} ({interface}): check power, cable, termination and bit rate")


@contextlib.contextmanager
def session_on(channel: str, interface: str, bitrate: int | None) -> Iterator[Session]:
    if interface == "socketcan" and bitrate is not None:
        advice = f"SocketCAN has the bit rate of the interface. Set it there: {command_for_rate(channel, bitrate)}"
        raise InputFaults(Path("--bitrate"), [advice])
    try:
        bus = BusWiring(name=channel, interface=interface, channel=channel, bitrate=bitrate or 1_000_000)
        with session_without_executor([bus]) as session:
            yield session
    except CommandFailed as error:
        if "cannot open" not in str(error):
            raise
        advice = f"check that {channel} is up and that its --interface is {interface}"
        raise CommandFailed(str(error), advice) from None


def command_for_rate(channel: str, bitrate: int) -> str:
    return f"sudo ip link set {channel} down && sudo ip link set {channel} up type can bitrate {bitrate}"


def rows(it: ProbedNode, channel: str) -> Iterable[tuple[str, str]]:
    if not it.answers and it.state is State.STOPPED:
        yield "state", stopped(f"{channel}/{it.node}")
        return
    if not it.answers:
        yield "state", f"{it.state.words if it.state is not None else 'unknown'}; does not answer SDO requests"
        return
    yield "device", device(it)
    yield "identity", "1018h: " + listed(it, 0x1018, 8, ("vendor", "product", "revision", "serial"))
    yield "type", device_type(it.numbers.get((0x1000, 0)))
    yield "state", "no heartbeat heard" if it.state is None else it.state.words
    yield "outputs", process_data(it, 0x6200, it.rpdos)
    yield "inputs", process_data(it, 0x6000, it.tpdos)
    yield from ((pdo_words(pdo.parameters), pdo_text(pdo)) for pdo in (*it.rpdos, *it.tpdos))
    yield "supervision", "; ".join(supervision(it))
    yield "error state", "; ".join(error_state(it))
    yield "errors", "; ".join(errors(it))
    yield "SYNC", ", ".join(number(it, index, 0, 8) for index in (0x1005, 0x1006, 0x1019))
    yield "polarity", listed(it, 0x6202, 2) if (0x6202, 0) in it.numbers else "no 6202h"
    yield "storing", storing(it)
    for (index, sub), code in it.refused.items():
        yield "refused", f"{index:04X}h sub {sub}: {objects.abort_words(code)}"
    if it.trouble is not None:
        yield "trouble", it.trouble


def device(it: ProbedNode) -> str:
    texts = [f"{it.texts[index]} ({index:04X}h)" for index in TEXTS if it.texts.get(index)]
    return ", ".join(texts) or "no texts (1008h to 100Ah)"


def device_type(kind: int | None) -> str:
    if kind is None:
        return "1000h cannot be read"
    if kind & 0xFFFF != PROFILE:
        return f"1000h = {kind:08X}h: profile {kind & 0xFFFF}, not CiA 401"
    has = [words for bit, words in KINDS.items() if kind >> bit & 1]
    return f"1000h = {kind:08X}h: CiA 401, {', '.join(has) or 'no inputs or outputs'}"


def process_data(it: ProbedNode, index: int, pdos: Iterable[PdoState]) -> str:
    """Returns the size of an input or output array [bits], and the PDOs that carry it."""
    count = it.numbers.get((index, 0))
    if not count:
        return f"no {index:04X}h" if count is None else f"{index:04X}h sub 0 = 0"
    carried = [
        f"{pdo_words(pdo.parameters)} bits {first.bit} to {last.bit + last.width - 1}"
        for pdo in pdos
        if (bits := sorted(carries(pdo.mapping, index)))
        for first, last in [(bits[0], bits[-1])]
    ]
    return f"{8 * count} bits in {index:04X}h; {', '.join(carried) or 'no PDO carries them'}"


def pdo_text(pdo: PdoState) -> str:
    entries = " ".join(f"{entry:08X}h" for entry in pdo.mapping) or "nothing"
    state = "enabled" if pdo.valid else "disabled"
    timer = "" if not pdo.timer else f", timer {pdo.timer} ms"
    return f"{state}, COB-ID {pdo.cob_id:08X}h, transmission type {pdo.kind}{timer}, maps {entries}"


def supervision(it: ProbedNode) -> Iterable[str]:
    if (count := it.numbers.get((0x1016, 0))) is None:
        yield "no 1016h (heartbeat consumer)"
    else:
        yield f"1016h: {count} heartbeat consumers: {listed(it, 0x1016, 8)}"
    yield number(it, 0x1017, 0, 4, lambda value: f"heartbeat every {value} ms" if value else "no heartbeat")
    yield number(it, 0x100C, 0, 4, lambda value: f"guard time {value} ms")
    yield number(it, 0x100D, 0, 2, lambda value: f"life time factor {value}")


def error_state(it: ProbedNode) -> Iterable[str]:
    for index in (0x6206, 0x6207):
        yield f"{index:04X}h: {listed(it, index, 2)}" if (index, 0) in it.numbers else f"no {index:04X}h"
    yield number(it, 0x1029, 1, 2, lambda value: LOST.get(value, "of the maker"))


def errors(it: ProbedNode) -> Iterable[str]:
    """Yields error register and error history in words."""
    yield number(it, 0x1001, 0, 2)
    if (count := it.numbers.get((0x1003, 0))) is None:
        yield "no 1003h (error history)"
        return
    yield f"1003h: {count} entries" if count else "1003h: empty"
    for sub in range(1, 1 + count):
        if (value := it.numbers.get((0x1003, sub))) is not None:
            yield f"{value:08X}h {cia301.emergency_words(value & 0xFFFF)}"


def storing(it: ProbedNode) -> str:
    value = it.numbers.get((0x1010, 1))
    if value is None:
        return "no 1010h sub 1"
    how = [words for bit, words in ((0, "on command"), (1, "by itself at each write")) if value >> bit & 1]
    return f"1010h sub 1 = {value:08X}h: {', '.join(how) or 'not'}"


def number(it: ProbedNode, index: int, sub: int, digits: int, words: Callable[[int], str] | None = None) -> str:
    place = f"{index:04X}h" + (f" sub {sub}" if sub else "")
    value = it.numbers.get((index, sub))
    if value is None:
        return f"no {place}"
    return f"{place} = {value:0{digits}X}h" + (f", {words(value)}" if words else "")


def listed(it: ProbedNode, index: int, digits: int, names: tuple[str, ...] = ()) -> str:
    """Returns the entries of an array object, with names if given."""
    values = [(sub, it.numbers[index, sub]) for sub in range(1, 255) if (index, sub) in it.numbers]
    named = dict(enumerate(names, 1))
    return ", ".join(f"{named.get(sub, '')} {value:0{digits}X}h".lstrip() for sub, value in values) or "nothing"


def as_mapping(it: ProbedNode) -> dict[str, Any]:
    return {
        "node": it.node,
        "answers": it.answers,
        "state": None if it.state is None else it.state.words,
        "texts": {f"{index:04X}h": text for index, text in it.texts.items()},
        "objects": {f"{index:04X}h:{sub}": value for (index, sub), value in sorted(it.numbers.items())},
        "refused": {f"{index:04X}h:{sub}": f"{code:08X}h" for (index, sub), code in it.refused.items()},
        "pdos": {
            pdo_words(pdo.parameters): {
                "cob_id": pdo.cob_id,
                "enabled": pdo.valid,
                "transmission_type": pdo.kind,
                "inhibit": pdo.inhibit,
                "timer": pdo.timer,
                "mapping": [f"{entry:08X}h" for entry in pdo.mapping],
            }
            for pdo in (*it.rpdos, *it.tpdos)
        },
        "trouble": it.trouble,
    }
