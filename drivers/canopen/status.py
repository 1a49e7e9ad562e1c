"""State and counters of buses and boards, for diagnostics."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Traffic:
    """The worst-case traffic of an arm on one bus, see `layout.worst_case`.

    Attributes:
        heartbeats: heartbeats of the boards and the master [bit/s].
        sync: SYNC [bit/s].
        rpdos: RPDOs, the commands [bit/s].
        tpdos: TPDOs, the end-stops [bit/s].
        load: sum as a fraction of the bit rate; the bus cannot carry more than 1.
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
        ignored: received frames that were not understood (remote, extended, too short, other nodes).
        overruns: times that the controller has lost received frames, since its buffer was full.
        frames_per_second: all sent and received frames, over about the last second.
        bits_per_second: bits of those frames, with the greatest possible number of stuff bits.
        load: these bits as a fraction of the bit rate, 0..1.
        worst_case: computed worst-case traffic of this arm.
    """

    name: str
    state: str
    tx_frames: int
    rx_frames: int
    tx_errors: int
    rx_errors: int
    dropped: int
    ignored: int
    overruns: int
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
        state: NMT state in words; "unknown" before the first heartbeat, "lost" after a timeout.
        heartbeat_age: time since its last heartbeat [s]; None before the first.
        unverified: switches and reads whose outputs could not be read back.
        emergency: its last emergency in words; None without an emergency, or after its end.
    """

    bus: str
    node: int
    state: str
    heartbeat_age: float | None
    unverified: int
    emergency: str | None


@dataclass(frozen=True)
class MasterStatus:
    """All buses and boards."""

    buses: tuple[BusStatus, ...]
    boards: tuple[BoardStatus, ...]
