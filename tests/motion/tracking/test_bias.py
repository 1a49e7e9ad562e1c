"""The tip bias: estimated under noise, clamped, robust to outliers; filterpy's filter without scipy."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from hyperbit.controller.motion.tracking.bias import AGREEING, TipBias, Tracker, decode
from hyperbit.controller.refusals.refusal import Refusal

TRACKER = Tracker(noise=1e-4, clamp=0.01, drift=1e-5, hold=60.0)
SEEDS = st.integers(0, 2**32 - 1)


def fed(bias: TipBias, true: np.ndarray, rng: np.random.Generator, count: int, start: float = 0.0) -> int:
    """Gives noisy samples of a bias, 20 a second; returns how many were accepted."""
    noise = rng.normal(size=(count, len(true))) * TRACKER.noise
    return sum(bias.measure(true + off, start + 0.05 * k) for k, off in enumerate(noise))


@given(st.sampled_from([2, 3]), SEEDS)
def test_a_steady_bias_is_found_as_well_as_its_deviation_says(dimension, seed):
    rng, bias = np.random.default_rng(seed), TipBias(dimension, TRACKER)
    true = rng.uniform(-0.005, 0.005, dimension)
    assert fed(bias, true, rng, 200) >= 197
    found, deviation = bias.estimate
    assert deviation < TRACKER.noise / 3
    assert np.abs(found - true).max() < 5 * deviation
    assert_allclose(bias.at(10.0), found, atol=1e-12)


def test_a_slow_change_is_followed():
    rng, bias = np.random.default_rng(1), TipBias(2, Tracker(1e-4, 0.01, 1e-4, 60.0))
    for k in range(1000):
        bias.measure(np.array([1e-3 * k / 1000, 0.0]) + rng.normal(size=2) * 1e-4, 0.05 * k)
    assert_allclose(bias.at(50.0), [1e-3, 0.0], atol=2e-4)


@given(SEEDS)
def test_outliers_change_nothing(seed):
    rng, bias = np.random.default_rng(seed), TipBias(2, TRACKER)
    fed(bias, np.array([0.003, 0.0]), rng, 100)
    before, dropped = bias.at(5.0), bias.track.outliers
    for k in range(AGREEING * 3):  # each at another place
        angle = 2.4 * k
        assert not bias.measure(0.01 * np.array([np.cos(angle), np.sin(angle)]), 5.1 + 0.05 * k)
    assert_array_equal(bias.at(9.0), before)
    assert (bias.track.outliers - dropped, bias.track.jumps) == (AGREEING * 3, 0)


def test_outliers_that_agree_are_the_bias():
    rng, bias = np.random.default_rng(2), TipBias(2, TRACKER)
    fed(bias, np.array([0.003, 0.0]), rng, 100)
    fed(bias, np.array([0.0, 0.006]), rng, AGREEING - 1, 10.0)
    assert_allclose(bias.at(11.0), [0.003, 0.0], atol=1e-4)
    fed(bias, np.array([0.0, 0.006]), rng, 10, 20.0)
    assert_allclose(bias.at(21.0), [0.0, 0.006], atol=1e-4)
    assert bias.track.jumps == 1


def test_no_correction_is_longer_than_the_clamp_and_what_is_far_is_refused():
    bias = TipBias(2, TRACKER)
    fed(bias, np.array([0.012, 0.009]), np.random.default_rng(3), 50)
    assert_allclose(bias.at(3.0), [0.008, 0.006], atol=1e-4)
    assert np.linalg.norm(bias.at(3.0)) <= 0.01 * (1 + 1e-12)
    with pytest.raises(Refusal, match=r"position: 0.021 from the computed tip, at most 0.02 is accepted"):
        bias.measure(np.array([0.021, 0.0]), 4.0)


def test_it_holds_for_so_long_and_is_then_none():
    bias = TipBias(2, TRACKER)
    assert bias.estimate is None
    assert_array_equal(bias.at(0.0), [0, 0])
    fed(bias, np.array([0.003, 0.0]), np.random.default_rng(4), 50)
    assert bias.at(2.45 + 60.0)[0] > 0.0029
    assert_array_equal(bias.at(2.46 + 60.0), [0, 0])
    assert bias.measure(np.array([-0.003, 0.0]), 100.0)  # earlier samples do not count
    assert bias.at(100.0)[0] < -0.0029


def test_samples_out_of_order_are_refused():
    bias = TipBias(2, TRACKER)
    bias.measure(np.zeros(2), 1.0)
    with pytest.raises(Refusal, match="before the last accepted one"):
        bias.measure(np.zeros(2), 0.9)


def test_a_message_is_read():
    position, stamp = decode(b'{"stamp": 1.5, "position": [1, 2.5], "orientation": 0.5}', 2)
    assert (position.tolist(), stamp) == ([1.0, 2.5], 1.5)
    assert decode(b'{"stamp": 1, "position": [1, 2, 3], "orientation": [0, 0, 0, 1]}', 3)[0].tolist() == [1, 2, 3]


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        ('{"position": [1, 2]}', "stamp: required, but missing"),
        ('{"stamp": 1}', "position: required, but missing"),
        ('{"stamp": 1, "position": [1, 2, 3]}', "position: 3 coordinates, this arm's positions have 2"),
        ('{"stamp": 1, "position": [1, NaN]}', "position[1]: nan is not a finite number"),
        ('{"stamp": 1, "position": [1, 1e7]}', "position[1]"),
        ('{"stamp": 1, "position": [1, 2], "orientation": NaN}', "orientation"),
        ('{"stamp": 1, "position": [1, 2], "orientation": [0, 0, 0, 1]}', "orientation: an angle is needed"),
        ('{"stamp": 1, "position": [1, 2], "noise": 1}', "noise: unknown field"),
        ('{"stamp": -1, "position": [1, 2]}', "stamp"),
    ],
)
def test_faults_of_a_message(text, fault):
    with pytest.raises(Refusal) as raised:
        decode(text.encode(), 2)
    assert fault in str(raised.value)


PROGRAM = """
import sys
from hyperbit.controller.motion.tracking.kalman import kalman_filter, white_noise

filter = kalman_filter(4, 2)
assert filter.x.shape[0] == 4
assert white_noise(2, 0.1, 1.0).shape == (4, 4)
assert not {"scipy.linalg", "scipy.ndimage", "scipy.sparse", "scipy.stats"} & set(sys.modules)
import scipy.linalg, scipy.ndimage, scipy.sparse.linalg, scipy.stats
assert scipy.stats.norm.cdf(0.0) == 0.5
assert scipy.linalg.block_diag([1], [2]).shape == (2, 2)
assert scipy.ndimage.uniform_filter([2.0, 2.0])[0] == scipy.sparse.eye(2).sum()
"""


@pytest.mark.parametrize("before", ["", "import scipy.stats, filterpy.kalman"])
def test_scipy_is_not_imported_by_the_filter_and_can_be_imported_before_or_later(before: str) -> None:
    program = "".join(line for line in PROGRAM.splitlines(True) if not (before and line.startswith("assert not")))
    subprocess.run([sys.executable, "-c", before + program], check=True, timeout=100)
