"""Boards and the CANopen master in their simulated world."""

from __future__ import annotations

import pytest

from tests.simulation.fieldbus.world import BoardWorld

STEPS = 4_000


@pytest.mark.parametrize("seed", range(8))
def test_boards_are_booted_switched_and_watched_as_the_pages_say(seed: int) -> None:
    BoardWorld(seed).run(STEPS)


def test_a_seed_replays_exactly() -> None:
    first, second = (BoardWorld(3, remembered=10**6) for _ in range(2))
    for world in (first, second):
        world.run(STEPS)
    assert second.story() == first.story()
