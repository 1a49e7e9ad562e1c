"""Error frames of SocketCAN: the state of the CAN controller, from linux/can/error.h."""

from __future__ import annotations

from typing import NamedTuple

_CONTROLLER, _BUS_OFF, _RESTARTED = 0x04, 0x40, 0x100  # classes, in the identifier
_WARNING, _PASSIVE, _ACTIVE = 0x04 | 0x08, 0x10 | 0x20, 0x40  # details, in data[1]


class ErrorFrame(NamedTuple):
    """The content of one error frame.

    Attributes:
        state: of the controller, "active", "warning", "passive" or "bus-off"; None if the frame does not tell.
        errors: its error counters in sending and receiving; None if the frame does not tell.
    """

    state: str | None
    errors: tuple[int, int] | None


def read_error(identifier: int, data: bytes) -> ErrorFrame:
    """Returns the content of an error frame."""
    data = data.ljust(8, b"\0")
    state: str | None = None
    if identifier & _CONTROLLER:
        details = ((_PASSIVE, "passive"), (_WARNING, "warning"), (_ACTIVE, "active"))
        state = next((name for detail, name in details if data[1] & detail), None)
    if identifier & _RESTARTED:
        state = "active"
    if identifier & _BUS_OFF:
        state = "bus-off"
    return ErrorFrame(state, (data[6], data[7]) if identifier & _CONTROLLER else None)
