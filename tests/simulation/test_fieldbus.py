"""Boards and the CANopen master in their simulated world."""

from __future__ import annotations

from itertools import count

import pytest

from tests.simulation.faults.fault import Row
from tests.simulation.faults.table import UNJUDGED, rows
from tests.simulation.fieldbus import commands
from tests.simulation.fieldbus.world import ALONE, BoardWorld

STEPS = 4_000
ENOUGH, MOST_SEEDS = 4, 60  # strikes of each fault; seeds until it has struck so often: few arms fit some
ELSEWHERE = UNJUDGED - {"outputs were written"} | {"new error among kept ones"}  # tests/drivers has the last
JUDGED = [row for row in (*rows(*ALONE, "left"), *commands.ROWS) if row.name not in ELSEWHERE]


@pytest.mark.parametrize("seed", range(8))
def test_boards_are_booted_switched_and_watched_as_the_pages_say(seed: int) -> None:
    BoardWorld(seed).run(STEPS)


@pytest.mark.parametrize("row", JUDGED, ids=lambda row: row.name)
def test_each_fault_is_told_as_its_row_says(row: Row) -> None:
    """What is left on a board is corrected by the next boot, or refused."""
    struck, kind = 0, "left" if row.strikes == "left" else "fault"
    for seed in count():
        assert seed < MOST_SEEDS, f"it has struck {struck} times"
        world = BoardWorld(seed, only=row)
        world.run(STEPS)
        struck += world.counts()[f"fieldbus: {kind}: {row.name}"]
        if struck >= ENOUGH:
            break


def test_a_seed_replays_exactly() -> None:
    first, second = (BoardWorld(3, remembered=10**6) for _ in range(2))
    for world in (first, second):
        world.run(STEPS)
    assert second.story() == first.story()
