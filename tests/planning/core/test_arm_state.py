"""The arm at a snapshot, its mode and the sentence on its program; prepared searches; measured tips and their bias."""

from __future__ import annotations

import json
import math
from functools import cached_property
from typing import Any

import numpy as np
import pytest

from hyperbit.controller.arm.arm import Arm
from hyperbit.controller.armfile.settings import TrackerSettings
from hyperbit.controller.planning.core.arm import ArmState
from hyperbit.controller.planning.core.goals import IDLE, REHEARSE_EVERY, Preparation
from hyperbit.controller.planning.core.premises import TipBiasEstimator
from hyperbit.controller.planning.core.tasks import Done, PrepareSearch
from hyperbit.controller.program import Fault
from tests.planning.rig.played_core import PlayedCore


@pytest.fixture
def played(small: Arm) -> PlayedCore:
    played = PlayedCore(small)
    played.show()
    return played


def computed(state: ArmState | None) -> dict[str, Any]:
    return {name: getattr(state, name) for name, value in vars(ArmState).items() if isinstance(value, cached_property)}


def test_a_snapshot_without_a_change_of_actuators_is_not_computed_again(played: PlayedCore) -> None:
    before = computed(played.view.state)
    played.show(faults=(Fault("a", "b", "c"),), reason="holding still", epoch=9)
    assert played.view.state is not None
    assert played.view.state.snapshot.epoch == 9
    after = computed(played.view.state)
    assert all(after[name] is before[name] for name in before)


@pytest.mark.parametrize(
    "change",
    [
        {"outputs": b"\x07\x00"},
        {"measured": b"\x07\x00"},
        {"known": b"\xfe\x0f"},
        {"sensed": b"\x00\x00"},
        {"known": b"\xfe\x0f", "homing": b"\x01\x00"},
        {"locked": b"\x01\x00"},
        {"unread": b"\x01\x00"},
        {"outputs": b"\x07\x00", "measured": b"\x00\x00", "moving": True},
    ],
    ids=lambda change: ", ".join(change),
)
def test_a_change_of_actuators_is_computed_anew(played: PlayedCore, change: dict[str, Any]) -> None:
    computed(played.view.state)
    played.show(**change)
    later = played.view.state
    assert later is not None
    fresh = computed(ArmState(played.arm.manipulator, later.snapshot))
    for name, value in computed(later).items():
        np.testing.assert_equal(value, fresh[name], name)


def test_the_sentence_on_a_program_ends_with_a_fault_before_the_arm_is_ready_again(played: PlayedCore) -> None:
    for mode in ("executing", "fault", "starting"):
        played.show(mode=mode, reason=mode)
        if mode == "executing":
            played.view.ended("holding; goal a was aborted")
    played.show(mode="ready", reason="holding what the boards measured")
    assert played.view.mode() == ("ready", "holding what the boards measured")
    played.show(mode="starting", reason="booting")
    played.view.ended("holding; goal b was aborted")  # its result was owed
    played.show(mode="ready", reason="holding what the boards measured")
    assert played.view.mode() == ("ready", "holding what the boards measured")


def test_a_program_that_ended_before_the_first_snapshot_gives_no_reason(played: PlayedCore) -> None:
    played.view.lost("the executor closed the connection")
    played.view.ended("holding; goal a was reached")  # long ago, perhaps before a fault
    played.show(mode="ready", reason="holding what the boards measured")
    assert played.view.mode() == ("ready", "holding what the boards measured")


def test_the_sentence_on_a_program_stays_until_the_executor_gives_another_reason(played: PlayedCore) -> None:
    played.show(mode="executing", reason="goal a")
    played.view.ended("holding; goal a was reached")
    for _ in range(2):
        played.show(mode="ready", reason="holding; goal a is done")
        assert played.view.mode() == ("ready", "holding; goal a was reached")
    played.show(mode="ready", reason="canceled")
    assert played.view.mode() == ("ready", "canceled")


def test_a_search_is_prepared_after_a_pause_and_the_next_look_comes_a_rehearsal_later(small: Arm) -> None:
    played = PlayedCore(small)
    played.show()
    preparation = Preparation(played.parts, played.premises, played.programs, prepares=True)
    preparation.begin(None)
    assert preparation.advance() == played.now + IDLE
    played.advance(IDLE)
    assert preparation.advance() == math.inf
    number, _ = played.task(PrepareSearch)
    played.answer(number, Done())
    assert preparation.advance() == pytest.approx(played.now + REHEARSE_EVERY, abs=1e-9)


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
