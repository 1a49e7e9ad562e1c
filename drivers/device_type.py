"""Whether a board is what the wiring takes it for (1000h: CiA 301, 7.5.2.1; CiA 401, 6.2)."""

from __future__ import annotations

from drivers.faults import Fault
from drivers.layout import Board
from drivers.sdo import BoardError, Sdo

_IO_PROFILE, _HAS_INPUTS, _HAS_OUTPUTS = 0x191, 1 << 16, 1 << 17


def check_type(board: Board, sdo: Sdo) -> int:
    """Returns the device type of a board.

    Raises:
        BoardError: it has not the digital outputs, or inputs, that are wired; or it does not answer.
    """
    kind = sdo.read(0x1000, 0, size=4)
    needs = _HAS_OUTPUTS | (_HAS_INPUTS if board.inputs else 0)
    if kind & 0xFFFF != _IO_PROFILE or kind & needs != needs:
        what = "outputs and inputs" if board.inputs else "outputs"
        text = (
            f"board {board.name} is of device type {kind:08X}h, not a CiA 401 board with digital {what}"
            f" ({needs | _IO_PROFILE:08X}h): is the node id right?"
        )
        raise BoardError(Fault("wrong-device", board.name, text))
    return kind
