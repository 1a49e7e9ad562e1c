"""The load of a bus: measured, and the worst case computed from an arm's wiring."""

from __future__ import annotations

from hyperbit.drivers.canopen.layout import Layout
from hyperbit.drivers.canopen.status import Traffic
from hyperbit.drivers.canopen.wire import cia301
from hyperbit.drivers.canopen.wiring import BusWiring, Timing

BITS = tuple(cia301.wire_bits(size) for size in range(9))  # on the wire, by bytes of data


class Meter:
    """Counts the traffic of one bus.

    Attributes:
        tx_frames: frames sent.
        rx_frames: frames received.
        frames_per_second: sent and received frames, over about the last second.
        bits_per_second: bits of those frames, with the greatest possible number of stuff bits.
    """

    def __init__(self) -> None:
        self.tx_frames = self.rx_frames = 0
        self.frames_per_second = self.bits_per_second = 0.0
        self._bits = 0
        self._counted: tuple[float, int, int] | None = None

    def sent(self, size: int) -> None:
        """Counts a sent frame of `size` bytes of data."""
        self.tx_frames += 1
        self._bits += BITS[min(size, 8)]

    def unsent(self, size: int) -> None:
        """Subtracts a frame that could not be sent."""
        self.tx_frames -= 1
        self._bits -= BITS[min(size, 8)]

    def received(self, bits: int) -> None:
        """Counts a received frame of `bits` on the wire."""
        self.rx_frames += 1
        self._bits += bits

    def tick(self, now: float) -> None:
        """Computes the rates once a second; `now` in [s]."""
        if self._counted is not None and now - self._counted[0] < 1.0:
            return
        frames = self.tx_frames + self.rx_frames
        if self._counted is not None:
            elapsed = now - self._counted[0]
            self.frames_per_second = (frames - self._counted[1]) / elapsed
            self.bits_per_second = (self._bits - self._counted[2]) / elapsed
        self._counted = now, frames, self._bits


def worst_case(layout: Layout, timing: Timing, bus: BusWiring) -> Traffic:
    """Returns the greatest traffic of boards and master on a bus without faults.

    Each frame has the greatest number of stuff bits. There is one transition in each travel time, without a pause. Each
    transition sends all RPDOs and switches all actuators; each end-stop causes its own TPDO. SDO transfers and
    emergencies are not counted.

    Args:
        layout: boards of all buses.
        timing: times of boards and actuators; a travel time below 1 ms counts as 1 ms.
        bus: the bus.
    """
    boards = [board for board in layout.boards if board.bus == bus.name]
    frames = {pdo.cob_id: pdo.size for board in boards for pdo in board.rpdos}
    commits = 1 / max(timing.travel_time, 0.001)
    heartbeats = (len(boards) + 1) * cia301.wire_bits(1) / timing.heartbeat
    rpdos = commits * sum(cia301.wire_bits(size) for size in frames.values())
    sync = commits * cia301.wire_bits(0) if frames else 0.0
    greatest = {board.name: max((pdo.size for pdo in board.tpdos), default=0) for board in boards}
    tpdos = commits * sum(len(board.inputs) * cia301.wire_bits(greatest[board.name]) for board in boards)
    return Traffic(heartbeats, sync, rpdos, tpdos, (heartbeats + sync + rpdos + tpdos) / bus.bitrate)
