"""Executor, daemon and boards in their simulated worlds."""

from __future__ import annotations

import pickle
import re
import subprocess
import sys
from itertools import count
from pathlib import Path

import pytest

from hyperbit.controller.executor.core.core import Executor
from hyperbit.controller.executor.core.events import Action, Event
from hyperbit.controller.motion.decoding.goal import BEGIN_WITHIN
from hyperbit.controller.planning.core import parts
from tests.simulation.__main__ import KINDS, world_of
from tests.simulation.faults.fault import Row
from tests.simulation.faults.table import UNJUDGED, rows
from tests.simulation.fieldbus import commands
from tests.simulation.fieldbus.world import ALONE, BoardWorld
from tests.simulation.world import World

ROOT = Path(__file__).parents[2]
STEPS, EVERY = 3_000, 50  # steps of a world, and between two pickles
ADDRESS = re.compile(r" at 0x[0-9a-f]+")


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("kind", KINDS)
def test_no_statement_is_violated(kind: str, seed: int) -> None:
    world_of(seed, kind).run(STEPS)


@pytest.mark.parametrize("kind", ["whole", "boards"])
def test_a_seed_replays_exactly(kind: str) -> None:
    first, second = (world_of(5, kind, remembered=10**6) for _ in range(2))
    first.run(STEPS)
    second.run(STEPS)
    assert ADDRESS.sub("", second.story()) == ADDRESS.sub("", first.story())


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


# --- each fault of the table alone

MOST_SEEDS = 60  # until each fault has struck: few arms fit some
OF_DRIVERS = {"new error among kept ones"}  # tests/drivers has it
OF_BOARDS = OF_DRIVERS | {"another program writes outputs", "another program writes outputs that are not used"}
NAMES = sorted({*World(0).single_faults.names} - UNJUDGED - OF_BOARDS | {"executor is killed"})
UNTOLD = UNJUDGED - {"outputs were written"} | OF_DRIVERS
ROWS = [row for row in (*rows(*ALONE, "left"), *commands.ROWS) if row.name not in UNTOLD]


@pytest.mark.parametrize("name", NAMES)
def test_the_executor_tells_each_fault_as_its_row_says(name: str) -> None:
    struck = 0
    for seed in count():
        assert seed < MOST_SEEDS, "it has never struck"
        world = World(seed, only=name)
        world.run(STEPS)
        struck += world.trouble.made[f"only: {name}"]
        if struck:
            return


@pytest.mark.parametrize("row", ROWS, ids=lambda row: row.name)
def test_the_master_tells_each_fault_as_its_row_says(row: Row) -> None:
    """What is left on a board is corrected by the next boot, or refused."""
    struck, kind = 0, "left" if row.strikes == "left" else "fault"
    for seed in count():
        assert seed < MOST_SEEDS, f"it has struck {struck} times"
        world = BoardWorld(seed, only=row)
        world.run(4_000)
        struck += world.counts()[f"fieldbus: {kind}: {row.name}"]
        if struck >= 2:
            return


# --- what no world draws


def test_a_hung_search_ends_the_process(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(parts, "HUNG", 2.0)
    world = World(0, whole=True)
    daemon = world.daemon
    assert daemon is not None
    world.calm()
    daemon.mood.hangs = True
    daemon.clients.ask("goal", daemon.clients.wishes.simple_goal())
    world.pass_time(BEGIN_WITHIN + 4.0)
    assert daemon.counts["planners that failed"] == 1
    world.calm()


@pytest.mark.parametrize("seed", range(2))
def test_a_core_from_a_pickle_takes_the_same_actions(monkeypatch: pytest.MonkeyPatch, seed: int) -> None:
    step, copies, compared = Executor.step, dict[int, Executor](), [0]

    def step_both(self: Executor, event: Event, now: float) -> list[Action]:
        copy = copies.get(id(self))
        actions = step(self, event, now)
        if copy is not None:
            compared[0] += 1
            assert step(copy, event, now) == actions
        return actions

    monkeypatch.setattr(Executor, "step", step_both)
    world = World(seed)
    for k in range(2 * STEPS):
        core = world.executor.core
        if k % EVERY == 0 and core is not None and core.calm:
            copies = {id(core): pickle.loads(pickle.dumps(core))}
        world.one_step()
    assert compared[0] > STEPS / 5
