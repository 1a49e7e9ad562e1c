"""State and counters of buses and boards, for diagnostics."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Traffic:
    """The traffic of an arm on one bus at worst, see `load.worst_case`.

    Attributes:
        heartbeats: of the boards and the master [bit/s].
        sync: of the master [bit/s].
        rpdos: commands [bit/s].
        tpdos: end-stops [bit/s].
        load: their sum as a share of the bit rate; above 1 the bus cannot carry it.
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
        tx_errors: transmit error counter of the controller, as of the last error frame.
        rx_errors: receive error counter, likewise.
        dropped: frames that could not be sent.
        ignored: frames received without a meaning here (remote, extended, too short, other nodes).
        frames_per_second: sent and received, by anybody, over about the last second.
        bits_per_second: of those frames, with the greatest possible number of stuff bits.
        load: these bits as a share of the bit rate, 0..1.
        worst_case: computed, of the traffic of this arm.
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
        state: of its network management in words; "unknown" before the first heartbeat, "lost" after a time-out.
        heartbeat_age: time since its last heartbeat [s], None before the first.
        emergency: its last emergency in words; None if there is none or it is over.
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
