"""What diagnostics tell of the buses and boards."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Traffic:
    """What an arm's own frames come to on one bus at worst, see `load.worst_case`.

    Attributes:
        heartbeats: of the boards and the master [bit/s].
        sync: of the master [bit/s].
        rpdos: commands [bit/s].
        tpdos: end-stops [bit/s].
        load: all of them, as a share of the bit rate; above 1 the bus cannot keep up.
    """

    heartbeats: float
    sync: float
    rpdos: float
    tpdos: float
    load: float


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
        frames_per_second: sent and received, by anybody, over about the last second.
        bits_per_second: of those frames, stuff bits not seen but taken as many as there can be.
        load: these bits as a share of the bit rate, 0..1.
        worst_case: computed, of the arm's own traffic.
    """

    name: str
    state: str
    tx_frames: int
    rx_frames: int
    tx_errors: int
    rx_errors: int
    dropped: int
    ignored: int
    frames_per_second: float
    bits_per_second: float
    load: float
    worst_case: Traffic


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
