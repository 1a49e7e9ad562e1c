"""The outputs and inputs of an arm's file: the board and the bit of each."""

import re
from collections.abc import Iterator, Sequence
from typing import NamedTuple

from hyperbit.controller.armfile.settings import (
    ActuatorSettings,
    ArmSettings,
    BitSettings,
    InputSettings,
    InterlockSettings,
)

BOARD = re.compile(r"([A-Za-z0-9_-]{1,64})/([1-9][0-9]{0,2})")
GREATEST_NODE = 126  # 127 is the master's
INPUT_WIDTHS = {0x6000: 8, 0x6020: 1, 0x6100: 16, 0x6120: 32}  # bits of a sub-index of the inputs (CiA 401)


class Terminal(NamedTuple):
    """One output or input of a board."""

    field: str  # name of its field, e.g. "output_off".
    bus: str  # name of its bus
    node: int  # id of its board
    bit: int  # its number on the board
    inverted: bool  # whether it is electrically 0 for 1

    @property
    def kind(self) -> str:
        """Returns "output" or "input"."""
        return self.field.split("_")[0]

    @property
    def board(self) -> tuple[str, int]:
        """Bus and node id of its board."""
        return self.bus, self.node


class Owned(NamedTuple):
    """A terminal, the path of its field, and the actuator or interlock to which it belongs."""

    path: str
    owner: str
    terminal: Terminal


def actuator_terminals(entry: ActuatorSettings) -> list[Terminal]:
    """Returns the outputs and inputs of an actuator, without inputs whose `board` is malformed."""
    found = []
    for field, bit in actuator_bits(entry).items():
        named = named_board(bit)
        board = (entry.bus, entry.node) if named is None else parse_board(named)
        if board is not None:
            found.append(Terminal(field, *board, bit.bit, bit.inverted))
    return found


def actuator_bits(entry: ActuatorSettings) -> dict[str, BitSettings | InputSettings]:
    """Returns the settings of the outputs and inputs of an actuator, by the names of their fields."""
    fields = {
        "output": entry.output,
        "output_off": entry.output_off,
        "input": entry.input,
        "input_contracted": entry.input_contracted,
    }
    return {name: bit_settings(bit) for name, bit in fields.items() if bit is not None}


def bit_settings(bit: int | BitSettings | InputSettings) -> BitSettings | InputSettings:
    """Returns the settings of an output or input that may be given as its number alone."""
    return BitSettings(bit) if isinstance(bit, int) else bit


def named_board(bit: BitSettings | InputSettings) -> str | None:
    """Returns the board that an input names; None: it is on the board of its actuator's outputs."""
    return bit.board if isinstance(bit, InputSettings) else None


def parse_board(text: str) -> tuple[str, int] | None:
    """Returns bus and node id of a board such as "can0/9"; None if the text is none."""
    match = BOARD.fullmatch(text)
    return (match[1], int(match[2])) if match and int(match[2]) <= GREATEST_NODE else None


def owned_terminals(settings: ArmSettings) -> Iterator[Owned]:
    """Yields all outputs and inputs of the file: those of the actuators, then those of the interlocks."""
    for k, entry in enumerate(settings.actuators):
        for terminal in actuator_terminals(entry):
            yield Owned(f"actuators[{k}].{terminal.field}", f"{entry.module}.{entry.actuator}", terminal)
    for name, lock in settings.interlocks.items():
        if (bit := interlock_bit(lock)) is not None:
            kind = "input" if lock.object is None else f"{lock.object:04X}h sub {lock.sub} bit"
            path = f"interlocks.{name}.{'input' if lock.object is None else 'bit'}"
            yield Owned(path, f"interlock {name}", Terminal(kind, lock.bus, lock.node, bit, lock.inverted))


def interlock_bit(lock: InterlockSettings) -> int | None:
    """Returns the bit of an interlock; None if the file lacks it."""
    return lock.input if lock.object is None else lock.bit


def named_boards(settings: ArmSettings) -> set[tuple[str, int]]:
    """Returns bus and node id of all boards of the file."""
    return {terminal.board for _, _, terminal in owned_terminals(settings)}


def check_terminals(settings: ArmSettings, faults: list[str]) -> None:
    """Appends the faults of buses and boards that are not there, and of outputs and inputs that are used twice."""
    buses = [bus.name for bus in settings.buses]
    for k, entry in enumerate(settings.actuators):
        if entry.bus not in buses:
            faults.append(f"actuators[{k}].bus: {no_bus(entry.bus, buses)}")
        for field, bit in actuator_bits(entry).items():
            if (named := named_board(bit)) is not None:
                _check_board(f"actuators[{k}].{field}.board", named, buses, faults)
    for name, lock in settings.interlocks.items():
        if lock.bus not in buses:
            faults.append(f"interlocks.{name}.bus: {no_bus(lock.bus, buses)}")
        faults += [f"interlocks.{name}{fault}" for fault in interlock_faults(lock)]
    taken: dict[tuple[str, str, int, int], str] = {}
    for path, owner, it in owned_terminals(settings):
        where = (it.kind, it.bus, it.node, it.bit)
        if where in taken:
            faults.append(f"{path}: {it.kind} {it.bit} of {it.bus}/{it.node} is {taken[where]}'s already")
        taken.setdefault(where, owner)


def interlock_faults(lock: InterlockSettings) -> Iterator[str]:
    """Yields the faults of the bit of an interlock, each with its field: ".object: ..."."""
    index = lock.object
    if index is None:
        if lock.bit is not None or lock.sub:
            yield f".{'sub' if lock.bit is None else 'bit'}: without `object`; needed is, for example, object: 0x2102"
        elif lock.input is None:
            yield ": neither input nor object; needed is, for example, input: 3, or object: 0x2102, sub: 0, bit: 0"
        return
    if lock.input is not None:
        yield f".input: {lock.input}, but {index:#06x} is given, too; an interlock is an input or a bit of an object"
    if lock.bit is None:
        yield ".bit: required with `object`, from 0 to 31"
    if index in INPUT_WIDTHS:
        bit = (lock.sub - 1) * INPUT_WIDTHS[index] + (lock.bit or 0)
        yield f".object: {index:#06x} has the inputs of the board; needed is input: {max(bit, 0)} in place of it"
    elif not may_be_watched(index):
        read = f"{index}"  # the hexadecimal number without its 0x
        hint = f"; did you mean 0x{read}?" if may_be_watched(int(read, 16)) else ""
        yield f".object: {index:#06x}, but 0x1001, 0x1002 or an object from 0x2000 to 0x9fff is needed{hint}"
    elif index < 0x2000 and (lock.sub or (lock.bit or 0) > (7 if index == 0x1001 else 31)):
        yield f".{'sub' if lock.sub else 'bit'}: {index:04X}h has sub 0 only, with 8 bits in 1001h and 32 in 1002h"
    elif index == 0x1001 and not lock.inverted:
        yield ".inverted: false, but the bits of 1001h (error register) are 1 in an error; needed is inverted: true"


def may_be_watched(index: int) -> bool:
    """Returns whether an interlock may be a bit of an object, by its index."""
    return index in (0x1001, 0x1002) or 0x2000 <= index < 0xA000


def no_bus(name: str, buses: Sequence[str]) -> str:
    """Returns the fault of an unknown bus, without its field."""
    if not buses:
        needed = f"buses: [{{name: {name}, interface: socketcan, channel: {name}, bitrate: 500000}}]"
        return f"{name!r}, but the file lists no buses; needed is, for example, {needed}"
    return f"{name!r} is none of the buses {', '.join(buses)}"


def _check_board(path: str, text: str, buses: Sequence[str], faults: list[str]) -> None:
    board = parse_board(text)
    if board is None:
        example = f"{buses[0] if buses else 'can0'}/9"
        faults.append(f"{path}: {text!r}, but a bus and a node id from 1 to {GREATEST_NODE} are needed, as {example}")
    elif board[0] not in buses:
        faults.append(f"{path}: {text!r}, but {no_bus(board[0], buses)}")
