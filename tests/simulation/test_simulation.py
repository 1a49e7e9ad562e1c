"""The executor in its simulated world."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from tests.simulation.faults.table import UNJUDGED
from tests.simulation.world import World

ROOT = Path(__file__).parents[2]
STEPS = 3_000


@pytest.mark.parametrize("seed", range(8))
def test_invariants_hold(seed: int) -> None:
    World(seed).run(STEPS)


ENOUGH, MOST_SEEDS = 2, 40  # strikes of each fault; seeds until it has struck so often: few arms fit some
ELSEWHERE = {  # the worlds of boards, or tests/drivers, have these
    *("another program writes outputs", "another program writes outputs that are not used"),
    "new error among kept ones",
}
NAMES = sorted({*World(0).single_faults.names} - UNJUDGED - ELSEWHERE | {"executor is killed"})


@pytest.mark.parametrize("name", NAMES)
def test_each_fault_is_told_as_its_row_says(name: str) -> None:
    struck = 0
    for seed in range(MOST_SEEDS):
        world = World(seed, only=name)
        world.run(STEPS)
        struck += world.trouble.made[f"only: {name}"]
        if struck >= ENOUGH:
            return
    raise AssertionError(f"it has struck {struck} times")


# In a process of its own: in this one, timers of other threads would never come.
REPLAY = f"""
import time
from tests.simulation.world import World

jumps = iter(range(0, 10**9, 997))
for clock in ("time", "monotonic", "time_ns", "monotonic_ns"):
    setattr(time, clock, lambda: next(jumps))
world = World(3, remembered=10**6)
world.run({STEPS})
print(world.story())
"""


def test_a_seed_replays_exactly_and_whatever_the_clock_of_the_system_says() -> None:
    world = World(3, remembered=10**6)
    world.run(STEPS)
    replay = subprocess.run([sys.executable, "-c", REPLAY], cwd=ROOT, stdout=subprocess.PIPE, text=True, check=True)
    assert replay.stdout == f"{world.story()}\n"
