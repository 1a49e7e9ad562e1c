"""Events of a CAN bus, as plain data. `bus.CanBus` makes them, `master.Master` takes them."""

from __future__ import annotations

from typing import NamedTuple

from hyperbit.drivers.canopen.wire.cia301 import Frame


class FrameReceived(NamedTuple):
    """A data frame with an 11 bit identifier from another node or program.

    Attributes:
        bus: name.
        frame: the frame.
        at: time on the bus, CLOCK_MONOTONIC [s]; None if the interface does not tell.
    """

    bus: str
    frame: Frame
    at: float | None = None


class FrameIgnored(NamedTuple):
    """A received frame of another kind: extended, remote or CAN FD.

    Attributes:
        bus: name.
        bits: greatest number of bits on the wire.
    """

    bus: str
    bits: int


class FrameEchoed(NamedTuple):
    """A frame was sent by this computer: by the master, or by another program on the same interface.

    Attributes:
        bus: name.
        frame: the frame.
        at: see `FrameReceived`.
    """

    bus: str
    frame: Frame
    at: float | None = None


class SendFailed(NamedTuple):
    """A frame could not be sent and is dropped."""

    bus: str
    frame: Frame
    why: str


class BusChanged(NamedTuple):
    """The state of the bus or its error counters have changed.

    Attributes:
        bus: name.
        state: "active", "warning", "passive", "bus-off", "down" or "closed"; None if it did not change.
        why: the reason as a sentence, or "".
        errors: transmit and receive error counter; None if unknown.
    """

    bus: str
    state: str | None
    why: str
    errors: tuple[int, int] | None


class BusOverrun(NamedTuple):
    """The controller has lost received frames, since its buffer was full."""

    bus: str


Event = FrameReceived | FrameIgnored | FrameEchoed | SendFailed | BusChanged | BusOverrun
