"""What error frames tell of a CAN controller: classes and details from linux/can/error.h."""

from __future__ import annotations

from typing import NamedTuple

import can

_CONTROLLER, _BUS_OFF, _RESTARTED = 0x04, 0x40, 0x100  # classes, in the identifier
_WARNING, _PASSIVE, _ACTIVE = 0x04 | 0x08, 0x10 | 0x20, 0x40  # details, in data[1]


class ErrorFrame(NamedTuple):
    """What one error frame says.

    Attributes:
        state: the controller is in now, "active", "warning", "passive" or "bus-off"; None if nothing is said of that.
        errors: its counters of errors in sending and in receiving; None if nothing is said of them.
    """

    state: str | None
    errors: tuple[int, int] | None


def read_error(message: can.Message) -> ErrorFrame:
    """Returns what an error frame says."""
    kind, data = message.arbitration_id, bytes(message.data).ljust(8, b"\0")
    state: str | None = None
    if kind & _CONTROLLER:
        details = ((_PASSIVE, "passive"), (_WARNING, "warning"), (_ACTIVE, "active"))
        state = next((name for detail, name in details if data[1] & detail), None)
    if kind & _RESTARTED:
        state = "active"
    if kind & _BUS_OFF:
        state = "bus-off"
    return ErrorFrame(state, (data[6], data[7]) if kind & _CONTROLLER else None)
