"""All rows of the table of faults."""

from __future__ import annotations

from tests.simulation.faults import boards, buses, left, motion, processes, pulses, reads
from tests.simulation.faults.fault import TABLE, Row

PARTS = (boards, buses, left, motion, processes, pulses, reads)  # each adds its rows as it is imported


def rows(*strikes: str) -> list[Row]:
    """Returns the rows that strike these: see `Row`."""
    return [row for row in TABLE.values() if row.strikes in strikes]
