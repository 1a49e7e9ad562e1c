"""Which measured tips count: those of an arm at rest, in time, on clocks that the test sets."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from controller.daemon.tip import TipWatch
from controller.settings import TrackerSettings
from tests.arms import paper_arm

BIAS = np.array([0.004, -0.002])


class FakeLoop:
    """What is read of the control loop."""

    def __init__(self) -> None:
        self.mode, self.commanded, self.free_at = "ready", np.array([1, 2, 3]), 0.0


class Field:
    """An arm of three trusses, a tracker, and clocks."""

    def __init__(self) -> None:
        self.now, self.wall, self.loop, self.arm = 1000.0, 1.8e9, FakeLoop(), paper_arm(3)
        settings = TrackerSettings(noise=1e-4, clamp=0.01)
        self.watch = TipWatch(self.arm, settings, self.loop, lambda: self.now, lambda: self.wall)  # type: ignore[arg-type]

    def send(self, age: float = 0.01, aside: np.ndarray = BIAS) -> dict[str, Any]:
        """A sample of so many seconds ago, and how the estimate fares then."""
        self.now, self.wall = self.now + 0.05, self.wall + 0.05
        configuration = [1, 2, 3] if self.loop.commanded is None else self.loop.commanded
        position = self.arm.tip(configuration)[:2, 3] + aside
        self.watch.take(json.dumps({"stamp": self.wall - age, "position": position.tolist()}).encode())
        return self.watch.status()


@pytest.fixture
def field():
    return Field()


def test_the_bias_is_told(field):
    for _ in range(20):
        status = field.send()
    assert_allclose(field.watch.bias(), BIAS, atol=1e-5)
    assert_allclose(field.watch.told()["bias"], BIAS, atol=1e-5)
    assert_allclose(status["estimate"], BIAS, atol=1e-5)
    assert (status["received"], status["accepted"], status["refused"], status["outliers"]) == (20, 20, 0, 0)


def test_nothing_is_told_before_the_first(field):
    status = field.watch.status()
    assert field.watch.bias().tolist() == status["bias"].tolist() == [0, 0]
    assert (status["estimate"], status["deviation"], status["last_refusal"]) == (None, None, None)


def test_an_outlier_is_counted(field):
    for _ in range(20):
        field.send()
    status = field.send(aside=-BIAS)
    assert (status["accepted"], status["outliers"]) == (20, 1)


@pytest.mark.parametrize(
    ("change", "age", "said"),
    [
        ({"mode": "fault"}, 0.01, "the arm is fault"),
        ({"mode": "starting", "commanded": None}, 0.01, "the arm is starting"),
        ({"free_at": 1000.1}, 0.01, "the arm was moving"),
        ({"free_at": 1000.0}, 0.06, "the arm was moving"),
        ({}, 1.1, "1.100 s old on arrival"),
        ({}, -0.1, "0.100 s in the future"),
    ],
)
def test_what_does_not_count_is_told(field, change, age, said):
    vars(field.loop).update(change)
    status = field.send(age=age)
    assert said in status["last_refusal"]
    assert (status["accepted"], status["refused"]) == (0, 1)
    assert field.watch.bias().tolist() == [0, 0]


def test_a_set_wall_clock_does_not_make_samples_of_moving_arms_count(field):
    field.loop.free_at = field.now + 10
    field.wall += 3600
    assert "the arm was moving" in field.send()["last_refusal"]


def test_nonsense_is_counted(field):
    field.watch.take(b"{")
    assert "not JSON" in field.watch.status()["last_refusal"]
