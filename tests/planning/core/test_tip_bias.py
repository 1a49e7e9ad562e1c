"""Measured tips and the tip bias, on a simulated clock."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest

from hyperbit.controller.arm.arm import Arm
from hyperbit.controller.armfile.settings import TrackerSettings
from hyperbit.controller.planning.core.premises import TipBiasEstimator
from tests.planning.rig.played_core import PlayedCore

OFFSET = np.array([0.002, -0.001])
HOLD = 60.0  # [s]


class BiasBench(PlayedCore):
    """An arm at rest whose tip is measured with a steady offset."""

    def __init__(self, arm: Arm) -> None:
        super().__init__(arm)
        settings = TrackerSettings(noise=1e-4, clamp=0.01, hold=HOLD)
        self.estimator = TipBiasEstimator(self.parts, self.locks, settings)
        self.show()

    def measure(self, age: float = 0.01, **fields: Any) -> None:
        measured = {"position": (self.tip(0, 0, 0, 0) + OFFSET).tolist(), "stamp": self.wall - age}
        self.estimator.receive_tip(json.dumps({**measured, **fields}).encode())

    def refusal(self) -> str:
        status = self.estimator.status()
        assert (status["received"], status["accepted"], status["refused"]) == (1, 0, 1)
        return str(status["last_refusal"])


@pytest.fixture
def bench(small: Arm) -> BiasBench:
    return BiasBench(small)


def test_the_bias_is_measured_minus_computed_tip(bench: BiasBench) -> None:
    for _ in range(50):
        bench.advance(0.05)
        bench.measure()
    assert bench.estimator.bias() == pytest.approx(OFFSET, abs=1e-4)
    status = bench.estimator.status()
    assert (status["accepted"], status["refused"], status["last_refusal"]) == (50, 0, None)
    assert status["estimate"] == pytest.approx(OFFSET, abs=1e-4)
    assert 0 < status["deviation"] < 1e-4
    bench.advance(HOLD + 1)
    assert bench.estimator.bias().tolist() == [0, 0]


def test_without_samples_the_bias_is_zero_and_json(bench: BiasBench) -> None:
    assert json.loads(json.dumps(bench.estimator.status()))["estimate"] is None
    assert bench.estimator.bias().tolist() == [0.0, 0.0]


@pytest.mark.parametrize(
    ("age", "refused"), [(1.1, "stamp: 1.100 s old on arrival"), (-0.1, "stamp: 0.100 s in the future")]
)
def test_late_and_early_samples_are_refused(bench: BiasBench, age: float, refused: str) -> None:
    bench.measure(age)
    assert bench.refusal().startswith(refused)


@pytest.mark.parametrize("changes", [{"moving": True}, {"free_at": 99.995}])
def test_a_tip_measured_before_the_arm_settled_is_refused(bench: BiasBench, changes: dict[str, Any]) -> None:
    bench.show(**changes)
    bench.measure(age=0.01)
    assert bench.refusal() == "stamp: the arm was moving, or not yet settled"


@pytest.mark.parametrize("changes", [{"mode": "fault"}, {"known": bytes(2)}])
def test_the_tip_of_an_arm_in_no_known_configuration_is_refused(bench: BiasBench, changes: dict[str, Any]) -> None:
    bench.show(**changes)
    bench.measure()
    assert bench.refusal().endswith("or its configuration is not known")


def test_a_tip_without_an_executor_is_refused(bench: BiasBench) -> None:
    bench.view.lost("the executor is gone")
    bench.measure()
    assert bench.refusal() == "the arm is fault, or its configuration is not known"


def test_malformed_and_far_samples_are_refused(bench: BiasBench) -> None:
    bench.measure(position=[1.0])
    bench.measure(position=[9.0, 9.0])
    assert bench.estimator.status()["refused"] == 2
