"""CANopen on the wire: COB-IDs, network management, emergencies and mappings, as pure functions on bytes."""

from __future__ import annotations

from enum import IntEnum
from functools import cache
from typing import NamedTuple

# Function codes of the pre-defined connection set (CiA 301, 7.3.5): the COB-ID is the function plus the node id.
NMT = 0x000
SYNC = 0x080  # with a node id added, the COB-ID of an emergency
EMERGENCY = 0x080
TPDO1 = 0x180
RPDO1 = 0x200
SDO_ANSWER = 0x580
SDO_REQUEST = 0x600
HEARTBEAT = 0x700

INVALID = 1 << 31  # of a PDO's COB-ID: the PDO is disabled (CiA 301, 7.5.2.35)
NO_REMOTE = 1 << 30  # of a TPDO's COB-ID: no answer to remote frames
BUS_OFF, RESTARTED = 0x40, 0x100  # classes of error frames, in the identifier, as in SocketCAN
REMOTE = 1 << 30  # of a frame's id: a remote frame, as in SocketCAN
DUMMY_BYTE = 0x0005_0008  # mapping of a byte for another board (CiA 301, 7.4.7)


class Frame(NamedTuple):
    """A CAN frame with an 11 bit identifier: a data frame of 0..8 bytes, or a remote frame, whose id has REMOTE."""

    id: int
    data: bytes = b""


class Command(IntEnum):
    """NMT commands (CiA 301, 7.2.8.3.1)."""

    START = 1
    STOP = 2
    PRE_OPERATIONAL = 128
    RESET_NODE = 129
    RESET_COMMUNICATION = 130


class State(IntEnum):
    """NMT states of a node, as in its heartbeat (CiA 301, 7.2.8.3.2)."""

    BOOT_UP = 0
    STOPPED = 4
    OPERATIONAL = 5
    PRE_OPERATIONAL = 127

    @property
    def words(self) -> str:
        """The state in words, for messages."""
        return self.name.lower().replace("_", "-").replace("boot-up", "booting")


STATES = {int(state): state for state in State}


def command(order: Command, node: int) -> Frame:
    """Returns the frame of an NMT command to one node; node 0: all nodes."""
    return Frame(NMT, bytes((order, node)))


def heartbeat(node: int, state: State) -> Frame:
    """Returns the frame of a heartbeat; with the state BOOT_UP it is the boot-up message."""
    return Frame(HEARTBEAT + node, bytes((state,)))


def split(cob_id: int) -> tuple[int, int]:
    """Returns the function code and the node id of an 11 bit identifier."""
    return cob_id & 0x780, cob_id & 0x7F


def mapping(index: int, sub: int, bits: int = 8) -> int:
    """Returns an entry of a PDO mapping; `bits` is its length (CiA 301, 7.5.2.36)."""
    return index << 16 | sub << 8 | bits


@cache
def wire_bits(size: int, extended: bool = False) -> int:
    """Returns the greatest number of bits of a data frame on the wire, for 0..8 bytes of data.

    All possible stuff bits and the 3 bits between frames are counted: 8 n + 47 + (34 + 8 n - 1) // 4 with an
    identifier of 11 bits, from Davis, Burns, Bril and Lukkien 2007, "Controller Area Network (CAN) schedulability
    analysis: Refuted, revisited and revised".
    """
    stuffed = (54 if extended else 34) + 8 * size
    return stuffed + 13 + (stuffed - 1) // 4


# CiA 301, 7.2.7.1 and the codes that CiA 401 adds. Other codes are named by their group, the first digits.
_EMERGENCIES = {
    0x0000: "no error",
    0x2310: "output overload",
    0x2320: "output short circuit",
    0x2330: "load dump at an output",
    0x3310: "output voltage too high",
    0x3320: "output voltage too low",
    0x8110: "CAN overrun, frames lost",
    0x8120: "CAN error passive",
    0x8130: "heartbeat of the master lost",
    0x8140: "recovered from bus-off",
    0x8150: "CAN identifier collision",
    0x8210: "PDO too short, not processed",
    0x8220: "PDO too long",
    0x8240: "unexpected SYNC length",
    0x8250: "RPDO timed out",
}
_EMERGENCY_GROUPS = {
    0x10: "generic error",
    0x20: "current",
    0x21: "current at the input side",
    0x22: "current inside the device",
    0x23: "current at the output side",
    0x30: "voltage",
    0x31: "mains voltage",
    0x32: "voltage inside the device",
    0x33: "output voltage",
    0x40: "temperature",
    0x41: "ambient temperature",
    0x42: "device temperature",
    0x50: "device hardware",
    0x60: "device software",
    0x61: "internal software",
    0x62: "user software",
    0x63: "data set",
    0x70: "additional modules",
    0x80: "monitoring",
    0x81: "communication",
    0x82: "protocol error",
    0x90: "external error",
    0xF0: "additional functions",
    0xFF: "device specific",
}


def emergency_words(code: int) -> str:
    """Returns an emergency error code in words, e.g. "output short circuit (2320h)"."""
    group = code >> 8
    words = _EMERGENCIES.get(code) or _EMERGENCY_GROUPS.get(group) or _EMERGENCY_GROUPS.get(group & 0xF0)
    return f"{words or 'unknown error'} ({code:04X}h)"
