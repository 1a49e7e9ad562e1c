"""What a board must be configured to: the values of objects that a wiring needs (CiA 301, 7.5.2; CiA 401, 7)."""

from __future__ import annotations

import math

from hyperbit.drivers.canopen.layout import BoardLayout
from hyperbit.drivers.canopen.pdo import subs_of
from hyperbit.drivers.canopen.sdo.objects import Need
from hyperbit.drivers.canopen.wiring import MASTER, NodeWiring, Timing

_PRE_OPERATIONAL, _STOPPED = 0, 2  # values of 1029h
_SYNC, _PRODUCES = 0x80, 1 << 30  # in 1005h
_CONTRACT = "with on_loss: contract, or with pulses, its outputs must go off when the master is lost"


def identity(settings: NodeWiring) -> list[Need]:
    """Identity, 1018h, as far as the arm's file gives it."""
    named = (
        (1, "vendor", settings.vendor),
        (2, "product", settings.product),
        (3, "revision", settings.revision),
        (4, "serial number", settings.serial),
    )
    other = "it is another device than the arm's file says: is the node id right?"
    return [
        Need(0x1018, sub, value, 4, what, required=other, fixed=other)
        for sub, what, value in named
        if value is not None
    ]


def synchronisation() -> list[Need]:
    """SYNC, 1005h to 1007h and 1019h: sent on demand with the COB-ID 080h, without a period, counter or window."""
    return [
        Need(0x1006, 0, 0, 4, "period of SYNC"),  # there is none: a missing SYNC is no error
        Need(0x1007, 0, 0, 4, "window after SYNC"),  # a board drops RPDOs that come after its window
        Need(0x1005, 0, 0, 4, "producing SYNC", mask=_PRODUCES),
        Need(0x1005, 0, _SYNC, 4, "COB-ID of SYNC", mask=0x7FFF_FFFF),
        Need(0x1019, 0, 0, 1, "counter of SYNC"),
    ]


def heartbeats(timing: Timing, entry: int = 1) -> list[Need]:
    """Supervision by heartbeats in both directions, 1016h and 1017h.

    `entry` is the sub-index of 1016h that watches the master; two entries must not watch one node.
    """
    watched = MASTER << 16 | _ms(timing.heartbeat_timeout)
    return [
        Need(0x1016, entry, watched, 4, "heartbeat of the master", rounded=True),
        Need(0x1017, 0, _ms(timing.heartbeat), 2, "period of its heartbeat", rounded=True),
    ]


def emergencies(node: int) -> list[Need]:
    """Emergencies, 1014h: sent with the COB-ID that the master receives."""
    return [Need(0x1014, 0, 0x80 + node, 4, "COB-ID of its emergencies")]


def guarding(timing: Timing) -> list[Need]:
    """Supervision by node guarding, 100Ch and 100Dh; the life time is the heartbeat timeout, rounded up."""
    factor = math.ceil(timing.heartbeat_timeout / timing.heartbeat)
    time = math.ceil(_ms(timing.heartbeat_timeout) / factor)
    return [
        Need(0x100C, 0, time, 2, "guard time", rounded=True),
        Need(0x100D, 0, factor, 1, "life time factor"),
    ]


def on_master_lost(board: BoardLayout, required: bool = True) -> Need:
    """Error behaviour, 1029h: the board's NMT state after the loss of the master.

    `required`: whether a board whose outputs must go off needs the object.
    """
    # A board that lost the master must leave operational: otherwise RPDOs and SYNC of a dying master still switch it.
    # Boards that hold enter pre-operational, in which they answer SDO. Boards that contract enter stopped, the only
    # state in which the boards of every vendor apply 6207h.
    falls = board.loss[0] != 0
    state = _STOPPED if falls else _PRE_OPERATIONAL
    return Need(0x1029, 1, state, 1, "error behaviour", required=_CONTRACT if falls and required else None)


def leaves_operational(behaviour: int | None) -> bool:
    """Returns whether a board with this 1029h leaves operational when it loses the master; None: no 1029h."""
    return behaviour in (None, _PRE_OPERATIONAL, _STOPPED)


def polarity(board: BoardLayout) -> list[Need]:
    """Polarity, 6202h: the board inverts no output. A write would switch the outputs."""
    advice = "the board inverts outputs. Write this while nothing can move: the write switches outputs"
    return [
        Need(0x6202, sub, 0, 1, "polarity of the outputs", mask=_byte(board.output_bits, sub), fixed=advice)
        for sub in subs_of(board.output_bits)
    ]


def hold_outputs(board: BoardLayout) -> list[Need]:
    """Error mode, 6206h: the outputs keep their values when the board loses the master."""
    bits = board.output_bits
    return [Need(0x6206, sub, 0, 1, "error mode", mask=_byte(bits, sub)) for sub in subs_of(bits)]


def error_mode(board: BoardLayout, required: bool = True) -> list[Need]:
    """Error mode and value, 6206h and 6207h: the outputs take their loss level when the board loses the master.

    `required`: whether a board whose outputs must go off needs the objects.
    """
    bits, (taken, levels), why = board.output_bits, board.loss, _CONTRACT if required else None
    needs = [
        Need(0x6207, sub, _byte(levels, sub), 1, "error value", mask=_byte(taken, sub), required=why)
        for sub in subs_of(taken)
    ]
    for sub in subs_of(bits):
        must = why if _byte(taken, sub) else None
        needs.append(Need(0x6206, sub, _byte(taken, sub), 1, "error mode", mask=_byte(bits, sub), required=must))
    return needs


def filters(board: BoardLayout) -> list[Need]:
    """Output filter, 6208h: the board accepts all used outputs."""
    bits = board.output_bits
    return [Need(0x6208, s, _byte(bits, s), 1, "output filter", mask=_byte(bits, s)) for s in subs_of(bits)]


def interrupts(board: BoardLayout) -> list[Need]:
    """Interrupts, 6005h and 6006h: the board sends its inputs when one changes."""
    bits = board.input_bits
    return [Need(0x6005, 0, 1, 1, "input interrupts")] * bool(bits) + [
        Need(0x6006, s, _byte(bits, s), 1, "interrupt at any change", mask=_byte(bits, s)) for s in subs_of(bits)
    ]


def _byte(bits: int, sub: int) -> int:
    return bits >> 8 * (sub - 1) & 0xFF


def _ms(seconds: float) -> int:
    return round(1000 * seconds)
