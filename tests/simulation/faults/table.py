"""All rows of the table of faults."""

from __future__ import annotations

from tests.simulation.faults import boards, buses, left, motion, processes, pulses, reads
from tests.simulation.faults.fault import TABLE, Row

PARTS = (boards, buses, left, motion, processes, pulses, reads)  # each adds its rows as it is imported

UNJUDGED = {  # nobody can say what is told of these alone
    *("frames are lost", "answers are very late", "answers are lost", "echoes are lost", "TPDO of a board is lost"),
    *("frame of random bytes", "executor is killed", "executor is killed after some actions", "executor is restarted"),
    *("planner hangs", "outputs were written", "actuator is jammed", "actuator is slow", "sensor is lost"),
    *("wires are cut", "wires are loose before strict stages", "arm is stopped while frames of a command wait"),
}


def rows(*strikes: str) -> list[Row]:
    """Returns the rows that strike these: see `Row`."""
    return [row for row in TABLE.values() if row.strikes in strikes]
