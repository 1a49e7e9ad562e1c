"""The greatest load that the traffic of an arm puts on a bus, computed from its wiring."""

from __future__ import annotations

from drivers.canopen import cia301
from drivers.canopen.layout import Layout
from drivers.canopen.status import Traffic
from drivers.canopen.wiring import BusSettings, Timing


def worst_case(layout: Layout, timing: Timing, bus: BusSettings) -> Traffic:
    """Returns the greatest traffic of boards and master on a bus without faults.

    Each frame has the greatest number of stuff bits. Transitions follow one another without a pause, one each travel
    time. Each transition sends all RPDOs and switches all actuators; each end-stop sends a TPDO of its own. SDO
    transfers at boot and emergencies are not counted.

    Args:
        layout: of all buses.
        timing: of boards and actuators; a travel time below 1 ms counts as 1 ms.
        bus: which.
    """
    boards = [board for board in layout.boards if board.bus == bus.name]
    frames = [frame for frame in layout.frames if frame.bus == bus.name]
    commits = 1 / max(timing.travel_time, 0.001) if frames else 0.0
    heartbeats = (len(boards) + 1) * cia301.wire_bits(1) / timing.heartbeat
    rpdos = commits * sum(cia301.wire_bits(frame.size) for frame in frames)
    sync = commits * cia301.wire_bits(0)
    tpdos = commits * sum(len(board.ends) * cia301.wire_bits(len(board.inputs)) for board in boards)
    return Traffic(heartbeats, sync, rpdos, tpdos, (heartbeats + sync + rpdos + tpdos) / bus.bitrate)
