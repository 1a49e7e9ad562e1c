"""The object dictionary of a board: python-canopen's LocalNode with the rules of CiA 301 that it does not check."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

from canopen import LocalNode, ObjectDictionary, SdoAbortedError
from canopen.objectdictionary import UNSIGNED8, UNSIGNED16, UNSIGNED32, ODRecord, ODVariable

U8, U16, U32 = UNSIGNED8, UNSIGNED16, UNSIGNED32
INVALID = 1 << 31  # bit of a COB-ID
NO_DATA, LOCAL_STATE, RANGE, NOT_MAPPABLE, TOO_LONG = 0x08000024, 0x08000022, 0x06090030, 0x06040041, 0x06040042
HISTORY, CONSUMERS = 0x1003, 0x1016
MOST_ERRORS = 8
PDOS = 4  # in each direction
OUTPUTS_AND_DUMMY, INPUTS = (0x62000108, 0x62000208, 0x00050008), (0x60000108, 0x60000208)


class Kind(NamedTuple):
    """What differs between the boards.

    Attributes:
        error_mode: the board has 1029h, 6005h, 6206h and 6207h.
        rpdo_type: transmission type of the RPDOs as delivered.
        off_outside_operational: the pins are off in any state but operational, as in CANopenNode's example.
        end_in_history: the end of an error enters 1003h, and an empty entry is no data, as in CANopenNode.
    """

    error_mode: bool
    rpdo_type: int
    off_outside_operational: bool
    end_in_history: bool


MODULE = Kind(error_mode=True, rpdo_type=255, off_outside_operational=False, end_in_history=False)
PLAIN = Kind(error_mode=False, rpdo_type=254, off_outside_operational=True, end_in_history=True)


def objects_of(kind: Kind, node: int) -> ObjectDictionary:
    """Describes a board of 16 outputs and 16 inputs."""
    described = ObjectDictionary()

    def entry(index: int, sub: int, size: int, access: str, value: int, mappable: bool = False) -> ODVariable:
        made = ODVariable(f"{index:04X}h sub {sub}", index, sub)
        made.data_type, made.access_type, made.default, made.pdo_mappable = size, access, value, mappable
        return made

    def variable(index: int, size: int, access: str, value: int) -> None:
        described.add_object(entry(index, 0, size, access, value))

    def array(index: int, size: int, access: str, *values: int, mappable: bool = False) -> None:
        whole = ODRecord(f"{index:04X}h", index)
        whole.add_member(entry(index, 0, U8, "const", len(values)))
        for sub, value in enumerate(values, 1):
            whole.add_member(entry(index, sub, size, access, value, mappable))
        described.add_object(whole)

    def pdo(parameters: int, cob_id: int, kind_of_transmission: int, *mapped: int) -> None:
        array(parameters, U32, "rw", cob_id)
        record = described[parameters]
        record.add_member(entry(parameters, 0, U8, "const", 5 if parameters >= 0x1800 else 2))
        record.add_member(entry(parameters, 2, U8, "rw", kind_of_transmission))
        if parameters >= 0x1800:
            record.add_member(entry(parameters, 3, U16, "rw", 0))
            record.add_member(entry(parameters, 5, U16, "rw", 0))
        array(parameters + 0x200, U32, "rw", *mapped, *[0] * (8 - len(mapped)))
        described[parameters + 0x200].add_member(entry(parameters + 0x200, 0, U8, "rw", len(mapped)))

    variable(0x1000, U32, "ro", 0x00030191)
    variable(0x1001, U8, "ro", 0)
    array(HISTORY, U32, "ro", *[0] * MOST_ERRORS)
    described[HISTORY][0].access_type = "rw"
    variable(0x1005, U32, "rw", 0x80)
    variable(0x1006, U32, "rw", 0)
    variable(0x1014, U32, "rw", 0x80 + node)
    array(CONSUMERS, U32, "rw", 0, 0)
    variable(0x1017, U16, "rw", 0)
    array(0x1018, U32, "ro", 1001, 1, 1, 1000 + node)
    for k in range(PDOS):
        spare = INVALID * (k > 0)
        outputs, inputs = ((), ()) if k else (OUTPUTS_AND_DUMMY[:2], INPUTS)
        pdo(0x1400 + k, spare | 0x200 + 0x100 * k + node, kind.rpdo_type, *outputs)
        pdo(0x1800 + k, spare | 0x180 + 0x100 * k + node, 255, *inputs)
    array(0x6000, U8, "ro", 0, 0, mappable=True)
    array(0x6200, U8, "rw", 0, 0, mappable=True)
    if kind.error_mode:
        array(0x1029, U8, "rw", 0)
        variable(0x6005, U8, "rw", 1)
        array(0x6206, U8, "rw", 0xFF, 0xFF)
        array(0x6207, U8, "rw", 0, 0)
    return described


class NoNetwork:
    """What LocalNode needs of a network: it sends. Nothing runs in threads."""

    def __init__(self, send: Callable[[int, bytes], None]) -> None:
        self._send = send

    def send_message(self, cob_id: int, data: Any, remote: bool = False) -> None:
        self._send(cob_id, bytes(data))


class Dictionary(LocalNode):
    """Object dictionary, SDO server and emergency producer of one board.

    Attributes:
        history: entries of 1003h, the newest first.

    Args:
        stored: called with index and sub-index after each write over the bus.
    """

    def __init__(
        self, node: int, kind: Kind, send: Callable[[int, bytes], None], stored: Callable[[int, int], None]
    ) -> None:
        super().__init__(node, objects_of(kind, node))
        self._write_callbacks.remove(self.nmt.on_write)  # it would start a thread for 1017h
        self.sdo.network = self.emcy.network = NoNetwork(send)
        self.history: list[int] = []
        self._kind, self._stored = kind, stored

    def number(self, index: int, sub: int = 0) -> int:
        return int.from_bytes(self.get_data(index, sub), "little")

    def word(self, index: int) -> int:
        """Returns the first two bytes of an array of inputs or outputs as one number."""
        return self.number(index, 1) | self.number(index, 2) << 8

    def put(self, index: int, sub: int, value: int) -> None:
        size = len(self.get_data(index, sub))
        self.data_store.setdefault(index, {})[sub] = value.to_bytes(size, "little")

    def has(self, index: int) -> bool:
        return index in self.object_dictionary

    def mapping(self, index: int) -> list[tuple[int, int]]:
        """Returns index and sub-index of the mapped objects of a PDO, one byte each."""
        values = [self.number(index, k) for k in range(1, self.number(index, 0) + 1)]
        return [(value >> 16, value >> 8 & 0xFF) for value in values]

    def note_error(self, entry: int) -> None:
        self.history = [entry, *self.history][:MOST_ERRORS]

    def reset(self, first: int, last: int) -> None:
        for index in [index for index in self.data_store if first <= index <= last]:
            del self.data_store[index]

    def get_data(self, index: int, subindex: int, check_readable: bool = False) -> bytes:
        if index == HISTORY and subindex == 0:
            return bytes([len(self.history)])
        if index == HISTORY and subindex <= len(self.history):
            return self.history[subindex - 1].to_bytes(4, "little")
        if index == HISTORY and subindex <= MOST_ERRORS and self._kind.end_in_history:
            raise SdoAbortedError(NO_DATA)
        return super().get_data(index, subindex, check_readable)

    def set_data(self, index: int, subindex: int, data: bytes, check_writable: bool = False) -> None:
        if check_writable:
            self._check(index, subindex, int.from_bytes(data, "little"))
        super().set_data(index, subindex, data, check_writable)
        if index == HISTORY:
            self.history = []
        if check_writable:
            self._stored(index, subindex)

    def _check(self, index: int, sub: int, value: int) -> None:
        """Refuses what CiA 301 forbids (7.5.2.17 for 1003h, 7.5.2.35 to 7.5.2.38 for PDOs)."""
        if index == HISTORY and value:
            raise SdoAbortedError(RANGE)
        if index & 0xFF00 in (0x1400, 0x1800) and sub == 1:
            before = self.number(index, 1)
            if not before & INVALID and not value & INVALID and before != value:
                raise SdoAbortedError(RANGE)
        if index & 0xFF00 in (0x1600, 0x1A00):
            self._check_mapping(index, sub, value)

    def _check_mapping(self, index: int, sub: int, value: int) -> None:
        if not self.number(index - 0x200, 1) & INVALID or (sub and self.number(index, 0)):
            raise SdoAbortedError(LOCAL_STATE)
        if sub and value not in (OUTPUTS_AND_DUMMY if index < 0x1800 else INPUTS):
            raise SdoAbortedError(NOT_MAPPABLE)
        if sub:
            return
        if value > 8:
            raise SdoAbortedError(RANGE)
        if sum(self.number(index, k) & 0xFF for k in range(1, value + 1)) > 64:
            raise SdoAbortedError(TOO_LONG)
