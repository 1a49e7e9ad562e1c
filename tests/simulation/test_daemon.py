"""The whole daemon in its simulated world."""

from __future__ import annotations

import re

import pytest

from hyperbit.controller.motion.decoding.goal import BEGIN_WITHIN
from hyperbit.controller.planning.core import parts
from tests.simulation.world import World

STEPS = 3_000
ADDRESS = re.compile(r" at 0x[0-9a-f]+")


@pytest.mark.parametrize("seed", range(4))
def test_invariants_hold(seed: int) -> None:
    World(seed, whole=True).run(STEPS)


def test_a_seed_replays_exactly() -> None:
    first, second = (World(5, whole=True, remembered=10**6) for _ in range(2))
    first.run(STEPS)
    second.run(STEPS)
    assert ADDRESS.sub("", second.story()) == ADDRESS.sub("", first.story())


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
