"""The configuration of a board: what its objects must hold for a wiring (CiA 301, 7.5.2; CiA 401, 7)."""

from __future__ import annotations

import math

from drivers.canopen.layout import BoardLayout
from drivers.canopen.objects import Need
from drivers.canopen.pdo import subs_of
from drivers.canopen.wiring import MASTER, NodeSettings, Timing

_PRE_OPERATIONAL, _STOPPED = 0, 2  # values of 1029h
_SYNC, _PRODUCES = 0x80, 1 << 30  # in 1005h
_CONTRACT = "with on_loss: contract, or with pulses, its outputs must go off when the master is lost"


def identity(settings: NodeSettings) -> list[Need]:
    """1018h, as far as the arm's file names it."""
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
    """SYNC: sent on demand with the identifier 080h and without a counter."""
    return [
        Need(0x1006, 0, 0, 4, "period of SYNC"),  # SYNC is sent on demand: its absence is no error
        Need(0x1005, 0, 0, 4, "producing SYNC", mask=_PRODUCES),
        Need(0x1005, 0, _SYNC, 4, "COB-ID of SYNC", mask=0x7FFF_FFFF),
        Need(0x1019, 0, 0, 1, "counter of SYNC"),
    ]


def heartbeats(timing: Timing) -> list[Need]:
    """Supervision by heartbeats, both ways."""
    return [
        Need(0x1016, 1, MASTER << 16 | _ms(timing.heartbeat_timeout), 4, "heartbeat of the master"),
        Need(0x1017, 0, _ms(timing.heartbeat), 2, "period of its heartbeat"),
    ]


def guarding(timing: Timing) -> list[Need]:
    """Supervision by node guarding: the life time is the heartbeat time-out, a few milliseconds more at most."""
    factor = math.ceil(timing.heartbeat_timeout / timing.heartbeat)
    time = math.ceil(_ms(timing.heartbeat_timeout) / factor)
    return [
        Need(0x100C, 0, time, 2, "guard time"),
        Need(0x100D, 0, factor, 1, "life time factor"),
    ]


def on_master_lost(board: BoardLayout) -> Need:
    """1029h: what the board does to its state if the master is no longer heard."""
    # A board that lost the master must leave operational: otherwise RPDOs and SYNC of a dying master still switch it.
    # To hold, pre-operational: it still answers SDO. To contract, stopped: the one state in which every vendor applies
    # 6207h.
    falls = board.loss[0] != 0
    state = _STOPPED if falls else _PRE_OPERATIONAL
    return Need(0x1029, 1, state, 1, "error behaviour", required=_CONTRACT if falls else None)


def polarity(board: BoardLayout) -> list[Need]:
    """6202h: the outputs are not inverted by the board. Writing it would switch them."""
    advice = "the board inverts outputs; write this while nothing can move, for it switches them"
    return [
        Need(0x6202, sub, 0, 1, "polarity of the outputs", mask=_byte(board.output_bits, sub), fixed=advice)
        for sub in subs_of(board.output_bits)
    ]


def held(board: BoardLayout) -> list[Need]:
    """Error mode: the outputs keep their values."""
    bits = board.output_bits
    return [Need(0x6206, sub, 0, 1, "error mode", mask=_byte(bits, sub)) for sub in subs_of(bits)]


def error_mode(board: BoardLayout) -> list[Need]:
    """Error mode: what the outputs do if the master is no longer heard."""
    bits, (taken, levels) = board.output_bits, board.loss
    needs = [
        Need(0x6207, sub, _byte(levels, sub), 1, "error value", mask=_byte(taken, sub), required=_CONTRACT)
        for sub in subs_of(taken)
    ]
    for sub in subs_of(bits):
        must = _CONTRACT if _byte(taken, sub) else None
        needs.append(Need(0x6206, sub, _byte(taken, sub), 1, "error mode", mask=_byte(bits, sub), required=must))
    return needs


def filters(board: BoardLayout) -> list[Need]:
    """6208h: the board takes over all used outputs."""
    bits = board.output_bits
    return [Need(0x6208, s, _byte(bits, s), 1, "output filter", mask=_byte(bits, s)) for s in subs_of(bits)]


def interrupts(board: BoardLayout) -> list[Need]:
    """6005h and 6006h: the board sends its inputs when one changes."""
    bits = board.input_bits
    return [Need(0x6005, 0, 1, 1, "input interrupts")] * bool(bits) + [
        Need(0x6006, s, _byte(bits, s), 1, "interrupt at any change", mask=_byte(bits, s)) for s in subs_of(bits)
    ]


def _byte(bits: int, sub: int) -> int:
    return bits >> 8 * (sub - 1) & 0xFF


def _ms(seconds: float) -> int:
    return round(1000 * seconds)
