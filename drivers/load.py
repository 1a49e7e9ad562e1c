"""The load that an arm's own traffic can put on a bus, computed before a frame is sent."""

from __future__ import annotations

from drivers import cia301
from drivers.layout import Layout
from drivers.status import Traffic
from drivers.wiring import BusSettings, Timing


def worst_case(layout: Layout, timing: Timing, bus: BusSettings) -> Traffic:
    """Returns the most that boards and master send on a bus while all is well.

    Every frame has all the stuff bits there can be. Transitions follow one another without a pause, one each travel
    time, and each writes every RPDO and switches every actuator; end-stops are told one by one, a TPDO for each.
    SDOs at start-up and emergencies are left out, and goals that replace one another before they have arrived.

    Args:
        layout: of all buses.
        timing: of boards and actuators; without a travel time, one of 1 ms counts.
        bus: which.
    """
    boards = [k for k, board in enumerate(layout.boards) if board.bus == bus.name]
    frames = [frame for frame in layout.frames if frame.bus == bus.name]
    commits = 1 / max(timing.travel_time, 0.001) if frames else 0.0
    sensed = [int(layout.sensed[layout.board == k].sum()) for k in boards]
    ends = sum(n * cia301.wire_bits(len(layout.boards[k].inputs)) for n, k in zip(sensed, boards, strict=True))
    heartbeats = (len(boards) + 1) * cia301.wire_bits(1) / timing.heartbeat
    rpdos = commits * sum(cia301.wire_bits(frame.image.stop - frame.image.start) for frame in frames)
    sync, tpdos = commits * cia301.wire_bits(0), commits * ends
    return Traffic(heartbeats, sync, rpdos, tpdos, (heartbeats + sync + rpdos + tpdos) / bus.bitrate)
