"""The configuration of a board: objects to write for a wiring (CiA 301, 7.5.2; CiA 401, 7)."""

from __future__ import annotations

from typing import Literal

from drivers.canopen import cia301
from drivers.canopen.layout import BoardLayout, Pdo
from drivers.canopen.objects import Entry
from drivers.canopen.wiring import MASTER, Timing

OnLoss = Literal["hold", "contract"]

_ON_SYNC, _ON_CHANGE = 1, 255  # transmission types of RPDO and TPDO
_PRE_OPERATIONAL, _STOPPED = 0, 2  # values of 1029h


def hold(board: BoardLayout) -> list[Entry]:
    """Error mode: the outputs keep their values."""
    return [Entry(0x6206, sub, 0x00) for sub in board.outputs]


def error_mode(board: BoardLayout, on_loss: OnLoss) -> list[Entry]:
    """Error mode: what the outputs do if the master is no longer heard."""
    if on_loss == "hold":
        return hold(board)
    return [Entry(0x6207, sub, 0x00) for sub in board.outputs] + [Entry(0x6206, sub, 0xFF) for sub in board.outputs]


def communication(board: BoardLayout, timing: Timing, on_loss: OnLoss, no_remote: int) -> list[Entry]:
    """Heartbeats and PDOs, in the order of writing.

    Args:
        board: the board.
        timing: heartbeat times.
        on_loss: what the outputs do if the master is no longer heard.
        no_remote: bit 30 of 1800h as the board has it; some boards refuse another.
    """
    # A board that lost the master must leave operational: otherwise RPDOs and SYNC of a dying master still switch it.
    # To hold, pre-operational: it still answers SDO. To contract, stopped: the one state in which every vendor applies
    # 6207h.
    lost = _PRE_OPERATIONAL if on_loss == "hold" else _STOPPED
    entries = [
        Entry(0x1006, 0, 0, size=4, optional=True),  # SYNC is sent on demand: its absence is no error
        Entry(0x1016, 1, MASTER << 16 | _ms(timing.heartbeat_timeout), size=4),
        Entry(0x1029, 1, lost, optional=True),
        Entry(0x1017, 0, _ms(timing.heartbeat), size=2),
        *_pdo(board.rpdo, 0, _ON_SYNC),
    ]
    if board.tpdo is not None:
        entries += _pdo(board.tpdo, no_remote, _ON_CHANGE)
        entries.append(Entry(0x6005, 0, 1, optional=True))
    return entries


def final(entries: list[Entry]) -> list[Entry]:
    """The value of each object after all entries are written."""
    return list({(entry.index, entry.sub): entry for entry in entries}.values())


def _pdo(pdo: Pdo, flags: int, kind: int) -> list[Entry]:
    """The order of mapping a PDO: disable, unmap, map, enable (CiA 301, 7.5.2.36)."""
    parameters, mapping, cob_id = pdo.parameters, pdo.parameters + 0x200, flags | pdo.cob_id
    return [
        Entry(parameters, 1, cia301.INVALID | cob_id, size=4),
        Entry(parameters, 2, kind),
        Entry(parameters, 5, 0, size=2, optional=True),  # of an RPDO a deadline, of a TPDO a period: neither is wanted
        Entry(mapping, 0, 0),
        *(Entry(mapping, 1 + i, entry, size=4) for i, entry in enumerate(pdo.mapping)),
        Entry(mapping, 0, len(pdo.mapping)),
        Entry(parameters, 1, cob_id, size=4),
    ]


def _ms(seconds: float) -> int:
    return round(1000 * seconds)
