"""What may keep the next stage of a program: the judge's own rules."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

from tests.simulation.judge.waits import best_stage, best_stages


def program(*stages: tuple[int, float]) -> Any:
    """A program at time 0, whose first stage has begun."""
    told = [SimpleNamespace(states=states, at=at) for states, at in stages]
    return SimpleNamespace(taken=0, begin=0.0, strict_from=math.inf, stages=told)


def test_each_stage_may_be_due_that_homing_may_have_delayed() -> None:
    arm: Any = SimpleNamespace(most=1)
    run = program((0b000, 0.0), (0b001, 0.1), (0b111, 0.2), (0b010, 0.3), (0b011, 0.4))
    assert best_stage(arm, run, 0.35, 0b000) == 3
    assert best_stages(arm, run, 0.35, 0b000, 0.0) == {3}
    assert best_stages(arm, run, 0.35, 0b000, 0.1) == {1, 3}
    assert best_stages(arm, run, 0.35, 0b000, 0.3) == {1, 3}
    assert best_stages(arm, run, 0.65, 0b000, 0.3) == {3}
    run.strict_from = 0.0
    assert best_stages(arm, run, 0.65, 0b000, 0.0) == {1}
