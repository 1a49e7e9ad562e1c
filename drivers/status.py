"""What diagnostics tell of the buses and boards."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class BusStatus:
    """One bus.

    Attributes:
        name: of the bus.
        state: "closed", "active", "warning", "passive", "bus-off" or "down".
        tx_frames: frames sent.
        rx_frames: frames received.
        tx_errors: transmit error counter of the controller, as last heard in an error frame.
        rx_errors: receive error counter, likewise.
        dropped: frames that could not be queued.
        ignored: frames received that mean nothing here (remote, extended, too short).
        load: share of the bit rate in use over about the last second, 0..1, at worst-case stuffing.
    """

    name: str
    state: str
    tx_frames: int
    rx_frames: int
    tx_errors: int
    rx_errors: int
    dropped: int
    ignored: int
    load: float


@dataclass(frozen=True)
class BoardStatus:
    """One board.

    Attributes:
        bus: its bus.
        node: its node id.
        state: of its network management in words, "unknown" before the first heartbeat, "lost" after the last.
        heartbeat_age: time since its last heartbeat [s], None before the first.
        emergency: its last emergency in words, None when there is none or it is over.
    """

    bus: str
    node: int
    state: str
    heartbeat_age: float | None
    emergency: str | None


@dataclass(frozen=True)
class Status:
    """All buses and boards."""

    buses: tuple[BusStatus, ...]
    boards: tuple[BoardStatus, ...]
