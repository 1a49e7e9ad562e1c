"""Stages to a set-point."""

from typing import Any

import numpy as np
import pytest

from hyperbit.controller.motion.stages.pacing import Blocked
from hyperbit.controller.planning.core.tasks import FollowSetpoint
from hyperbit.controller.planning.workers import computations
from hyperbit.controller.planning.workers.computations import ArmModel, follow
from tests.planning.workers.conftest import HOME, A, Bench


def task(bench: Bench, position: list[float], bias: tuple[float, ...] | None = None, **changes: Any) -> FollowSetpoint:
    return FollowSetpoint(bench.basis(**changes), tuple(position), 0.01, bias)


@pytest.fixture
def model(bench: Bench) -> ArmModel:
    return ArmModel(bench.arm, "setpoints")


def test_stages_lead_to_the_set_point(bench: Bench, model: ArmModel) -> None:
    followed = follow(model, task(bench, bench.tip(*A)))
    assert (followed.note, followed.found) == ("", True)
    assert np.linalg.norm(bench.tip_of(followed.stages[-1]) - bench.tip(*A)) <= 0.005 + 1e-9
    among = follow(model, task(bench, bench.tip(*A), scene=bench.scene(([5.0, 5.0], 0.1))))
    assert among.stages


def test_the_arm_stays_where_no_switch_is_needed(bench: Bench, model: ArmModel) -> None:
    followed = follow(model, task(bench, bench.tip(*HOME)))
    assert followed._replace(seconds=0.0) == ((), "", True, 0.0)


def test_a_set_point_out_of_reach_is_told_as_it_was_sent(bench: Bench, model: ArmModel) -> None:
    followed = follow(model, task(bench, [5.0, 5.0], bias=(0.5, 0.0)))
    assert (followed.stages, followed.found) == ((), False)
    assert "out of reach at (5.5000, 5.0000): " in followed.note


def test_a_blocked_transition_is_told(bench: Bench, model: ArmModel, monkeypatch: pytest.MonkeyPatch) -> None:
    def blocked(*_: object) -> None:
        raise Blocked("module 2 is in it")

    monkeypatch.setattr(computations, "stages_to", blocked)
    followed = follow(model, task(bench, bench.tip(*A)))
    assert (followed.stages, followed.found) == ((), True)
    assert followed.note == ", but the transition to it is blocked: module 2 is in it"


def test_an_arm_whose_locks_change_stays(small: Any, small_densities: Any) -> None:
    bench = Bench(small, small_densities, bytes([0] + [255] * 11))
    followed = follow(ArmModel(small, "setpoints"), task(bench, bench.tip(*A), start=bench.start(b"\1\0")))
    assert followed.note.startswith(", which is not possible now: the locked actuators are changing")
