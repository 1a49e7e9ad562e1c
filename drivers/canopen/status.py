"""State and counters of buses and boards, for diagnostics."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Traffic:
    """The worst-case traffic of an arm on one bus [bit/s], see `layout.worst_case`."""

    heartbeats: float  # of the boards and the master
    sync: float
    rpdos: float  # the commands
    tpdos: float  # the end-stops
    load: float  # sum as a fraction of the bit rate; the bus cannot carry more than 1


@dataclass(frozen=True)
class BusStatus:
    name: str
    state: str  # "closed", "active", "warning", "passive", "bus-off" or "down"
    tx_frames: int
    rx_frames: int
    tx_errors: int  # transmit error counter of the controller, as of the last error frame
    rx_errors: int  # receive error counter, likewise
    dropped: int  # frames that could not be sent
    ignored: int  # received frames of other kinds (remote, extended, too short, other nodes)
    overruns: int  # the controller lost received frames, since its buffer was full
    frames_per_second: float  # sent and received, over about the last second
    bits_per_second: float  # of those frames, with the greatest possible number of stuff bits
    load: float  # these bits as a fraction of the bit rate, 0..1
    worst_case: Traffic  # computed for this arm


@dataclass(frozen=True)
class BoardStatus:
    bus: str
    node: int
    state: str  # NMT state in words; "unknown" before the first heartbeat, "lost" after a timeout
    heartbeat_age: float | None  # time since its last heartbeat [s]; None before the first
    unverified: int  # switches and reads whose outputs could not be read back
    emergency: str | None  # the last one in words; None without an emergency, or after its end


@dataclass(frozen=True)
class MasterStatus:
    buses: tuple[BusStatus, ...]
    boards: tuple[BoardStatus, ...]
