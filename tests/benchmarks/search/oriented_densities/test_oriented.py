"""Densities with orientation: their cells of rotation, and the Mapping Algorithm against enumeration."""

import math
from functools import reduce

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from scipy.spatial import KDTree
from scipy.stats import spearmanr

from hyperbit.controller.manipulator import frames
from hyperbit.controller.manipulator.manipulator import Manipulator
from hyperbit.controller.manipulator.module import transforms
from tests.arms import any_frames, every_configuration, every_tip, paper_arm, short_arms, spatial_arm
from tests.benchmarks.search.oriented_densities.frame_pixels import rotation_cell
from tests.benchmarks.search.oriented_densities.metric import distance
from tests.benchmarks.search.oriented_densities.oriented import OrientedDensities
from tests.benchmarks.search.oriented_densities.oriented_mapping import map_oriented

WEIGHT, PLENTY = 0.2, 1 << 16
ARMS = {"planar": paper_arm(5), "spatial": spatial_arm(5)}
both = pytest.mark.parametrize("manipulator", ARMS.values(), ids=ARMS)


def exact_counts(manipulator: Manipulator, densities: OrientedDensities) -> tuple[np.ndarray, np.ndarray]:
    """Counts of the whole arm's pixels, enumerated and mapped, for every pixel that has either."""
    keys, enumerated = np.unique(
        densities.keys_of(0, manipulator.tips(every_configuration(manipulator))), return_counts=True
    )
    own = densities.keys[: densities.offsets[1]]
    union = np.union1d(keys, own)
    exact, mapped = np.zeros(len(union)), np.zeros(len(union))
    exact[np.searchsorted(union, keys)] = enumerated
    mapped[np.searchsorted(union, own)] = np.exp(densities.level(0).astype(float))
    return exact, mapped


def rank_correlation(first: np.ndarray, second: np.ndarray) -> float:
    """Spearman's, over what is positive in either."""
    either = (first > 0) | (second > 0)
    return float(spearmanr(first[either], second[either]).statistic)


def random_rotations(number: int) -> np.ndarray:
    """Uniform rotations as positions 0 with quaternions, shape (n, 7)."""
    quaternions = np.random.default_rng(0).normal(size=(number, 4))
    unit = quaternions / np.linalg.norm(quaternions, axis=1)[:, None]
    return np.hstack((np.zeros((number, 3)), unit))


def test_cells_of_rotation_have_the_same_measure():
    number, turns = 60_000, 5
    counts = np.bincount([rotation_cell(q, False, turns) for q in random_rotations(number)], minlength=turns**3)
    expected = number / turns**3
    assert len(counts) == turns**3
    # Chi-squared of 124 degrees of freedom: 200 is beyond five standard deviations.
    assert ((counts - expected) ** 2 / expected).sum() < 200


@pytest.mark.parametrize("turns", [5, 11])
def test_rotations_of_one_cell_are_near_each_other(turns):
    first: dict[int, np.ndarray] = {}
    farthest = 0.0
    for q in random_rotations(20_000):
        own = first.setdefault(rotation_cell(q, False, turns), q)
        farthest = max(farthest, 2 * math.acos(min(1.0, abs(float(own[3:] @ q[3:])))))
    side = 2 * math.pi ** (2 / 3) / turns  # near the identity
    assert side < farthest < 2.5 * side


@given(any_frames, st.sampled_from([3, 9, 31]))
def test_a_quaternion_and_its_negative_are_one_rotation(frame, turns):
    q = np.concatenate((np.zeros(3), frames.quaternion(frame)))
    if q[6] > 1e-9:  # half turns lie on the cube's surface, where opposite points are the same
        assert rotation_cell(q, False, turns) == rotation_cell(-q, False, turns)


@given(st.floats(-4, 4), st.integers(-2, 2), st.sampled_from([3, 9, 31]))
def test_planar_cells_are_periodic(angle, times, turns):
    def cell(angle: float) -> int:
        return rotation_cell(np.array([0, 0, 0, 0, 0, math.sin(angle / 2), math.cos(angle / 2)]), True, turns)

    assert cell(2 * math.pi * (cell(angle) + times * turns) / turns) == cell(angle)
    assert abs(math.remainder(2 * math.pi * cell(angle) / turns - angle, 2 * math.pi)) <= math.pi / turns + 1e-9


@settings(max_examples=25)
@given(short_arms(), st.sampled_from([0.02, 0.1]))
def test_every_level_agrees_with_enumeration(manipulator, pixel):
    densities = map_oriented(manipulator, pixel, PLENTY, WEIGHT)
    for level in range(len(manipulator.modules) + 1):
        counts, tips = np.exp(densities.level(level).astype(float)), every_tip(manipulator, level)
        assert counts.sum() == pytest.approx(math.prod(manipulator.states[level:].tolist()), rel=1e-5)
        assert (np.diff(densities.keys[densities.offsets[level] : densities.offsets[level + 1]]) > 0).all()
        centres, _ = densities.cells(level)
        bound = math.sqrt(3) * densities.pixels[level] * (len(manipulator.modules) - level + 0.5) + 1e-9
        assert KDTree(centres).query(tips)[0].max() <= bound  # nothing reachable is missing
        assert KDTree(tips).query(centres)[0].max() <= bound  # each pixel is near a tip
        low, high = densities.box(level)
        assert (centres >= low).all()
        assert (centres <= high).all()
        mean = np.average(centres, axis=0, weights=counts)
        assert np.abs(mean - tips.mean(axis=0)).max() <= densities.pixels[level] / 2 + 1e-6


@pytest.mark.parametrize("arm", [paper_arm(3), spatial_arm(3)], ids=["planar", "spatial"])
def test_fine_pixels_count_exactly(arm):
    densities = map_oriented(arm, 0.0011, PLENTY, WEIGHT)
    tips = arm.tips(every_configuration(arm))
    near = np.array([[distance(f, g, WEIGHT) < 1e-6 for g in tips] for f in tips]).sum(axis=1)
    assert_allclose(densities.at(0, tips), np.log(near), atol=1e-6)
    assert densities.at(0, tips @ frames.spatial((0, 0, 0), (0, 0, 0.7, 1))).max() == -np.inf  # there, turned wrongly
    assert densities.at(0, np.array([frames.planar(50, 50)])) == -np.inf


@both
@pytest.mark.parametrize(("pixel", "level_pixels"), [(0.05, PLENTY), (0.01, 500)], ids=["coarse", "bounded"])
def test_pixels_rank_as_enumeration_ranks_them(manipulator, pixel, level_pixels):
    assert len(manipulator.actuators) == 15
    densities = map_oriented(manipulator, pixel, level_pixels, WEIGHT)
    assert rank_correlation(*exact_counts(manipulator, densities)) > 0.85


@settings(max_examples=25)
@given(short_arms(), st.integers(1, 300))
def test_no_level_has_more_pixels_than_allowed(manipulator, level_pixels):
    densities = map_oriented(manipulator, 0.02, level_pixels, WEIGHT)
    assert np.diff(densities.offsets).max() <= level_pixels
    assert (np.diff(densities.pixels) <= 0).all()  # never finer towards the base
    total = np.exp(densities.level(0).astype(float)).sum()
    assert total == pytest.approx(math.prod(manipulator.states.tolist()), rel=1e-5)


@pytest.mark.parametrize("arm", [paper_arm(400), spatial_arm(150)], ids=["planar", "spatial"])
def test_long_arms_neither_overflow_nor_lose_their_mean(arm):
    densities = map_oriented(arm, 0.02, 500, WEIGHT)
    values = densities.level(0).astype(float)
    assert np.isfinite(values).all()
    assert np.logaddexp.reduce(values) == pytest.approx(np.log(arm.states).sum(), rel=1e-3)
    # Modules are independent of each other: the mean tip is the product of the modules' mean frames.
    mean = reduce(np.matmul, [module.frames.mean(axis=0) for module in arm.modules])[:3, 3]
    own = np.average(densities.cells(0)[0], axis=0, weights=np.exp(values - values.max()))
    assert np.abs(own - mean).max() <= densities.pixels[0] / 2


def test_a_ring_of_orientations_closes():
    eighth = transforms([frames.planar(0, 0, k * math.pi / 4) for k in range(8)], planar=True)
    densities = map_oriented(Manipulator([eighth] * 3), 0.02, PLENTY, WEIGHT)
    assert_allclose(densities.level(0), math.log(64), rtol=1e-6)
    assert len(densities.level(0)) == 8


def test_the_last_level_is_the_tip_alone_and_progress_counts():
    for arm in ARMS.values():
        done: list[int] = []
        densities = map_oriented(arm, 0.05, PLENTY, WEIGHT, done.append)
        assert done == [1, 2, 3, 4, 5, 6]
        assert densities.at(5, np.eye(4)[None]) == 0
        assert densities.at(5, frames.spatial((0, 0, 0), (0, 0, 1, 1))[None]) == -np.inf


def test_a_pixels_measure():
    planar, spatial = (map_oriented(arm, 0.02, PLENTY, WEIGHT) for arm in (paper_arm(1), spatial_arm(1)))
    assert planar.volume(0) == pytest.approx(0.0004 * 2 * math.pi / 64)
    assert planar.volume(0) <= 0.02**3 / WEIGHT
    assert spatial.volume(0) == pytest.approx(0.02**3 * 8 * math.pi**2 / 43**3)
    assert spatial.volume(0) <= 0.02**6 / WEIGHT**3


@pytest.mark.parametrize("bounds", [(0, 100, 1), (0.1, 0, 1), (0.1, 100, 0)])
def test_bounds_must_be_positive(bounds):
    with pytest.raises(ValueError, match="must be positive"):
        map_oriented(paper_arm(1), *bounds)


def test_too_fine_a_pixel_is_refused():
    with pytest.raises(ValueError, match="too fine"):
        map_oriented(spatial_arm(2), 1e-6, 10_000, 1)
