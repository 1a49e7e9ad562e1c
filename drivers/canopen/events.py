"""What happens on a CAN bus, as plain data: `bus.CanBus` makes these events, `master.Master` takes them."""

from __future__ import annotations

from typing import NamedTuple

from drivers.canopen.cia301 import Frame


class Received(NamedTuple):
    """A data frame with an 11 bit identifier from another node or program.

    Attributes:
        bus: name.
        frame: the frame.
        at: when it was on the bus, CLOCK_MONOTONIC [s]; None if the interface does not tell.
    """

    bus: str
    frame: Frame
    at: float | None = None


class Ignored(NamedTuple):
    """Another frame: extended, remote or CAN FD.

    Attributes:
        bus: name.
        bits: on the wire at worst.
    """

    bus: str
    bits: int


class Echoed(NamedTuple):
    """A frame left this computer: a frame of ours, or of another program on the same interface.

    Attributes:
        bus: name.
        frame: the frame.
        at: as of `Received`.
    """

    bus: str
    frame: Frame
    at: float | None = None


class SendFailed(NamedTuple):
    """A frame was not sent and is not kept."""

    bus: str
    frame: Frame
    why: str


class Changed(NamedTuple):
    """The state of the bus, or its error counters.

    Attributes:
        bus: name.
        state: "active", "warning", "passive", "bus-off", "down" or "closed"; None if it did not change.
        why: a sentence, or "".
        errors: error counters in sending and receiving, None if unknown.
    """

    bus: str
    state: str | None
    why: str
    errors: tuple[int, int] | None


Event = Received | Ignored | Echoed | SendFailed | Changed
