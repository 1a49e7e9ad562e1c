"""Check of a board's device type against its wiring (1000h: CiA 301, 7.5.2.1; CiA 401, 6.2)."""

from __future__ import annotations

from drivers.canopen.faults import Fault
from drivers.canopen.layout import BoardLayout
from drivers.canopen.procedure import BoardError

_IO_PROFILE, _HAS_INPUTS, _HAS_OUTPUTS = 0x191, 1 << 16, 1 << 17


def check_type(board: BoardLayout, kind: int) -> None:
    """Checks the value of 1000h.

    Raises:
        BoardError: the board has no digital outputs, or inputs, though they are wired.
    """
    needs = _HAS_OUTPUTS | (_HAS_INPUTS if board.inputs else 0)
    if kind & 0xFFFF != _IO_PROFILE or kind & needs != needs:
        what = "outputs and inputs" if board.inputs else "outputs"
        text = (
            f"board {board.name} is of device type {kind:08X}h, not a CiA 401 board with digital {what}"
            f" ({needs | _IO_PROFILE:08X}h): is the node id right?"
        )
        raise BoardError(Fault("wrong-device", board.name, text))
