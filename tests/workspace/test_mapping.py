"""The Mapping Algorithm against enumeration of short arms."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from scipy.spatial import KDTree

from hyperbit.controller.manipulator import frames
from hyperbit.controller.manipulator.manipulator import Manipulator
from hyperbit.controller.manipulator.module import transforms
from hyperbit.controller.workspace.densities import Densities
from hyperbit.controller.workspace.mapping import map_densities
from tests.arms import (
    coordinates,
    every_tip,
    listed,
    modules,
    paper_arm,
    planar_modules,
    short_arms,
    spatial_arm,
    spatial_frames,
    vgts,
)

PLENTY = 1 << 18
KINDS = {
    "planar trusses": vgts,
    "planar frames": planar_modules,
    "spatial frames": listed(spatial_frames, planar=False),
    "mixed": modules,
}
each_kind = pytest.mark.parametrize("kind", KINDS.values(), ids=KINDS)


def reachable(densities: Densities, level: int) -> tuple[np.ndarray, np.ndarray]:
    """Centres (n, 3) and counts (n,) of a level's pixels that have points."""
    values = densities.level(level)
    z, y, x = np.nonzero(values >= 0)
    centres = densities.references[level] + densities.pixels[level] * np.column_stack((x, y, z))
    return centres, np.exp(values[values >= 0].astype(float))


def error_bound(manipulator: Manipulator, densities: Densities, level: int) -> float:
    """Greatest distance of a point from the centre of its pixel.

    Each module moves a point to the centroid of its new pixel, at most a diagonal away; the centre is half of one away
    from that. Rigid motions keep what has gone wrong before as it was.
    """
    diagonal = math.sqrt(manipulator.dimension) * densities.pixels[level:].max()
    return diagonal * (len(manipulator.modules) - level + 0.5) + 1e-9


@each_kind
@settings(max_examples=25)
@given(data=st.data(), pixel=st.sampled_from([0.02, 0.05, 0.2]))
def test_every_level_agrees_with_enumeration(kind, data, pixel):
    manipulator = data.draw(short_arms(kind))
    densities = map_densities(manipulator, pixel, PLENTY)
    for level in range(len(manipulator.modules) + 1):
        tips, bound = every_tip(manipulator, level), error_bound(manipulator, densities, level)
        centres, counts = reachable(densities, level)
        assert counts.sum() == pytest.approx(math.prod(manipulator.states[level:].tolist()), rel=1e-5)
        assert KDTree(centres).query(tips)[0].max() <= bound  # nothing reachable is missing
        assert KDTree(tips).query(centres)[0].max() <= bound  # each pixel is near a tip
        low, high = densities.box(level)
        assert (tips >= low - bound).all()
        assert (tips <= high + bound).all()
        # Moving centroids keeps the mean: only the rounding of the last level to centres shows in it.
        mean = np.average(centres, axis=0, weights=counts)
        assert np.abs(mean - tips.mean(axis=0)).max() <= densities.pixels[level] / 2 + 1e-6


@pytest.mark.parametrize("manipulator", [paper_arm(5), spatial_arm(5)], ids=["planar", "spatial"])
def test_the_error_shrinks_with_the_pixel(manipulator):
    tips, worst = every_tip(manipulator), []
    for pixel in (0.08, 0.04, 0.02, 0.01):
        centres, counts = reachable(map_densities(manipulator, pixel, 1 << 22), 0)
        # Distance between the two distributions along x: what would have to be carried how far.
        order, weights = np.sort(tips[:, 0]), np.round(counts).astype(int)
        carried = np.sort(np.repeat(centres[:, 0], weights))
        worst.append(np.abs(order - carried).mean())
        assert worst[-1] <= pixel / 2
    assert worst[-1] < worst[0] / 4


@settings(max_examples=25)
@given(short_arms(most=3), st.sampled_from([0.05, 0.1]))
def test_unreachable_pixels_hold_minus_their_distance_to_the_reachable(manipulator, pixel):
    densities = map_densities(manipulator, pixel, 1 << 14)
    for level in range(len(manipulator.modules) + 1):
        values = densities.level(level)
        reached, missed = np.argwhere(values >= 0), np.argwhere(values < 0)
        if len(missed):
            distances = densities.pixels[level] * KDTree(reached).query(missed)[0]
            assert_allclose(values[values < 0], -distances, rtol=1e-5)


@settings(max_examples=50)
@given(short_arms(), st.integers(1, 3000))
def test_no_level_has_more_pixels_than_allowed(manipulator, level_pixels):
    densities = map_densities(manipulator, 0.02, level_pixels)
    assert np.prod(densities.shapes, axis=1).max() <= level_pixels
    assert (np.diff(densities.pixels) <= 0).all()  # never finer towards the base
    assert np.diff(densities.offsets).tolist() == np.prod(densities.shapes, axis=1).tolist()
    for level in range(len(manipulator.modules) + 1):
        total = reachable(densities, level)[1].sum()
        assert total == pytest.approx(math.prod(manipulator.states[level:].tolist()), rel=1e-5)


@given(st.lists(coordinates, min_size=1, max_size=6), st.floats(0.03, 0.3))
def test_an_arm_may_climb_without_ever_spreading_along_z(heights, pixel):
    def climb(height: float):
        return transforms([frames.spatial((x, 0, height), (0, 0, x, 1)) for x in (0.1, 0.2)], planar=False)

    manipulator = Manipulator([climb(height) for height in heights])
    densities = map_densities(manipulator, pixel, PLENTY)
    centres, counts = reachable(densities, 0)
    assert counts.sum() == pytest.approx(2 ** len(heights), rel=1e-5)
    assert_allclose(centres[:, 2], sum(heights), atol=pixel / 2 + 1e-9)


def test_the_last_level_is_the_tip_alone(manipulator, densities):
    assert densities.level(16).tolist() == [[[0]]]
    assert densities.references[16].tolist() == [0, 0, 0]


def test_200_modules_neither_overflow_nor_lose_their_edge():
    manipulator = paper_arm(200)
    densities = map_densities(manipulator, 0.02, 20_000)
    assert np.isfinite(densities.values).all()
    for level in (0, 100, 190):
        values = densities.level(level).astype(float)
        total = np.logaddexp.reduce(values[values >= 0])
        assert total == pytest.approx((200 - level) * math.log(8), rel=1e-3)
    # Straight up, all extended, is as far as this arm goes. Pixels as wide as three modules are high cost some of it.
    farthest = np.linalg.norm(manipulator.tip(np.full(200, 7))[:3, 3])
    centres, counts = reachable(densities, 0)
    distances = np.linalg.norm(centres, axis=1)
    assert 0.9 * farthest < distances.max() < farthest + densities.pixels[0]
    # There few configurations come, by tens of orders of magnitude.
    assert np.log(counts[distances.argmax()]) < np.log(counts.max()) - 200


def test_1000_modules_are_mapped():
    densities = map_densities(paper_arm(1000), 0.02, 10_000)
    assert np.isfinite(densities.values).all()
    values = densities.level(0).astype(float)
    assert np.logaddexp.reduce(values[values >= 0]) == pytest.approx(1000 * math.log(8), rel=1e-3)


def test_progress_counts_the_levels():
    done: list[int] = []
    map_densities(paper_arm(4), 0.05, PLENTY, done.append)
    assert done == [1, 2, 3, 4, 5]


@pytest.mark.parametrize(("pixel", "level_pixels"), [(0, 100), (-0.1, 100), (0.1, 0)])
def test_bounds_must_be_positive(pixel, level_pixels):
    with pytest.raises(ValueError, match="must be positive"):
        map_densities(paper_arm(1), pixel, level_pixels)


def test_a_pixels_volume(densities):
    assert densities.volume(16, planar=True) == pytest.approx(0.0004)
    assert densities.volume(16, planar=False) == pytest.approx(0.000008)
