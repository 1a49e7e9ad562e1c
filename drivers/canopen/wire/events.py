"""Events of a CAN bus, as plain data. `bus.CanBus` makes them, `Master` takes them."""

from __future__ import annotations

from typing import NamedTuple

from hyperbit.drivers.canopen.wire.cia301 import Frame


class FrameReceived(NamedTuple):
    """A data frame with an 11 bit identifier from another node or program."""

    bus: str
    frame: Frame
    at: float | None = None  # time on the bus, CLOCK_MONOTONIC [s]; None if the interface does not tell


class FrameIgnored(NamedTuple):
    """A received frame of another kind: extended, remote or CAN FD."""

    bus: str
    bits: int  # greatest number on the wire


class FrameEchoed(NamedTuple):
    """A frame was sent by this computer: by the master, or by another program on the same interface."""

    bus: str
    frame: Frame
    at: float | None = None  # likewise


class SendFailed(NamedTuple):
    """A frame could not be sent and is dropped; `why` is a sentence."""

    bus: str
    frame: Frame
    why: str


class BusChanged(NamedTuple):
    """The state of the bus or its error counters have changed."""

    bus: str
    state: str | None  # "active", "warning", "passive", "bus-off", "down" or "closed"; None: it did not change
    why: str  # a sentence, or ""
    errors: tuple[int, int] | None  # transmit and receive error counter; None: unknown


class BusOverrun(NamedTuple):
    """The controller has lost received frames, since its buffer was full."""

    bus: str


Event = FrameReceived | FrameIgnored | FrameEchoed | SendFailed | BusChanged | BusOverrun
