"""The executor's core can be pickled, and a copy from a pickle goes on like the core itself."""

from __future__ import annotations

import pickle

import pytest

from hyperbit.controller.executor.core.core import Executor
from hyperbit.controller.executor.core.events import Action, Event
from tests.simulation.world import World

STEPS, EVERY = 6_000, 50  # steps of a world, and between two pickles


@pytest.mark.parametrize("seed", range(2))
def test_a_copy_from_a_pickle_takes_the_same_actions(monkeypatch: pytest.MonkeyPatch, seed: int) -> None:
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
    for k in range(STEPS):
        core = world.executor.core
        if k % EVERY == 0 and core is not None and core.calm:
            copies = {id(core): pickle.loads(pickle.dumps(core))}
        world.one_step()
    assert compared[0] > STEPS / 10
