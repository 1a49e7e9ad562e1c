"""The worst-case load of a bus, computed from an arm's wiring."""

from __future__ import annotations

from hyperbit.drivers.canopen.layout import Layout
from hyperbit.drivers.canopen.status import Traffic
from hyperbit.drivers.canopen.wire import cia301
from hyperbit.drivers.canopen.wiring import BusWiring, Timing


def worst_case(layout: Layout, timing: Timing, bus: BusWiring) -> Traffic:
    """Returns the greatest traffic of boards and master on a bus without faults.

    Each frame has the greatest number of stuff bits. There is one transition in each travel time, without a pause; a
    travel time below 1 ms counts as 1 ms. Each transition sends all RPDOs and switches all actuators; each end-stop
    causes its own TPDO. SDO transfers and emergencies are not counted.
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
