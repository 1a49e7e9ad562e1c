"""What is written to a board so that it does what the wiring says (CiA 301, 7.5.2; CiA 401, 7)."""

from __future__ import annotations

from typing import Literal

from drivers import cia301
from drivers.layout import Board
from drivers.sdo import Entry
from drivers.wiring import MASTER, Timing

_ON_SYNC, _ON_CHANGE = 1, 255  # transmission types of RPDO and TPDO
_PRE_OPERATIONAL, _STOPPED = 0, 2  # of 1029h


def hold(board: Board) -> list[Entry]:
    """Lets the outputs keep their values whatever happens."""
    return [Entry(0x6206, sub, 0x00) for sub in board.outputs]


def on_loss(board: Board, action: Literal["hold", "contract"]) -> list[Entry]:
    """What the outputs do when the master is no longer heard."""
    if action == "hold":
        return hold(board)
    return [Entry(0x6207, sub, 0x00) for sub in board.outputs] + [Entry(0x6206, sub, 0xFF) for sub in board.outputs]


def communication(board: Board, timing: Timing, action: Literal["hold", "contract"], no_remote: int) -> list[Entry]:
    """Heartbeats and PDOs, in the order they are to be written.

    Args:
        board: the board.
        timing: heartbeat times.
        action: on loss of the master.
        no_remote: bit 30 of 1800h as the board has it; some boards refuse another.
    """
    # A board that lost the master must leave operational, else the RPDOs and SYNC of a dying master still switch it.
    # To hold, pre-operational: it stays open to questions. To contract, stopped: the one state in which every vendor
    # applies 6207h.
    lost = _PRE_OPERATIONAL if action == "hold" else _STOPPED
    entries = [
        Entry(0x1006, 0, 0, size=4, optional=True),  # SYNC comes on demand: its absence is no error
        Entry(0x1016, 1, MASTER << 16 | _ms(timing.heartbeat_timeout), size=4),
        Entry(0x1029, 1, lost, optional=True),
        Entry(0x1017, 0, _ms(timing.heartbeat), size=2),
    ]
    entries += _pdo(0x1400, board.rpdo, _ON_SYNC, list(board.mapping))
    if board.inputs:
        mapping = [cia301.mapping(0x6000, sub) for sub in board.inputs]
        entries += _pdo(0x1800, no_remote | cia301.TPDO1 + board.node, _ON_CHANGE, mapping)
        entries.append(Entry(0x6005, 0, 1, optional=True))
    return entries


def final(entries: list[Entry]) -> list[Entry]:
    """What the objects hold after all entries are written."""
    return list({(entry.index, entry.sub): entry for entry in entries}.values())


def _pdo(index: int, cob_id: int, kind: int, mapping: list[int]) -> list[Entry]:
    """The order in which a PDO is mapped anew: switched off, unmapped, mapped, on again (CiA 301, 7.5.2.36)."""
    return [
        Entry(index, 1, cia301.INVALID | cob_id, size=4),
        Entry(index, 2, kind),
        Entry(index, 5, 0, size=2, optional=True),  # of an RPDO a deadline, of a TPDO a period: neither is wanted
        Entry(index + 0x200, 0, 0),
        *(Entry(index + 0x200, 1 + i, entry, size=4) for i, entry in enumerate(mapping)),
        Entry(index + 0x200, 0, len(mapping)),
        Entry(index, 1, cob_id, size=4),
    ]


def _ms(seconds: float) -> int:
    return round(1000 * seconds)
