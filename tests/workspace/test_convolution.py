"""Densities by convolution against enumeration and the Mapping Algorithm."""

import math
from functools import reduce

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from controller.manipulator import frames
from controller.manipulator.manipulator import Manipulator
from controller.manipulator.module import transforms
from controller.workspace import convolution, doubling
from controller.workspace.convolution import by_convolution
from controller.workspace.oriented_mapping import map_oriented
from tests.arms import paper_arm, planar_modules, short_arms, spatial_arm
from tests.workspace.comparing import (
    convolved_points,
    enumerated_points,
    mapped_points,
    rank_correlation,
    smoothed,
    total_variation,
)


def lattice(*steps: tuple[int, int, int]):
    """A module whose states are steps on the integers with quarter turns, where nothing lies between pixels."""
    return transforms([frames.planar(x, y, quarters * math.pi / 2) for x, y, quarters in steps], planar=True)


A, B = lattice((0, 1, 0), (1, 0, 1), (1, 1, 3)), lattice((2, 1, 2), (0, -1, 1), (0, 3, 0))


@pytest.mark.parametrize("modules", [[A] * 8, [A] * 9, [A, B] * 5, [A] * 5 + [B] * 4], ids=["8", "9", "10", "5+4"])
def test_on_a_lattice_convolution_counts_exactly(modules):
    counts = {(0, 0, 0): 1}
    turns = [(1, 0), (0, 1), (-1, 0), (0, -1)]
    for module in modules:
        states = [(*np.round(f[:2, 3]).astype(int), round(frames.angle(f) / (math.pi / 2))) for f in module.frames]
        before, counts = counts, {}
        for (x, y, t), count in before.items():
            c, s = turns[t]
            for dx, dy, dt in states:
                place = x + c * dx - s * dy, y + s * dx + c * dy, (t + dt) % 4
                counts[place] = counts.get(place, 0) + count
    density = by_convolution(Manipulator(modules), 1.0, 1 << 20, 4)
    points, shares = convolved_points(density)
    places = np.round(np.column_stack((points[:, :2], points[:, 2] / (math.pi / 2)))).astype(int)
    assert density.pixel == 1
    assert density.configurations == pytest.approx(len(modules) * math.log(3))
    found = {tuple(place): share * 3 ** len(modules) for place, share in zip(places.tolist(), shares, strict=True)}
    # Where rotations are not quite quarter turns by rounding, a neighbour gets the rest.
    assert set(counts) <= set(found)
    assert_allclose([found[place] for place in counts], list(counts.values()), rtol=1e-6)
    assert sum(found.values()) == pytest.approx(sum(counts.values()))


@settings(max_examples=25)
@given(short_arms(planar_modules), st.sampled_from([0.02, 0.1, 1.0]), st.sampled_from([2000, 50_000]))
def test_mass_and_mean_are_kept_for_any_planar_arm(arm, pixel, level_pixels):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(doubling, "ENUMERATED", 1)
        density = by_convolution(arm, pixel, level_pixels, 64)
    points, shares = convolved_points(density)
    tips, _ = enumerated_points(arm)
    assert density.shares.size <= level_pixels
    assert shares.sum() == pytest.approx(1, abs=1e-12)
    # An orientation between two slices is shared by both: their mean is shorter by up to the cosine of half a slice.
    lever = len(arm.modules) * arm.length * (1 - math.cos(math.pi / 64))
    assert np.abs(shares @ points[:, :2] - tips[:, :2].mean(axis=0)).max() < lever + 1e-6
    # Nothing lies farther out than a slice and a pixel for each time that a share was spread.
    assert np.linalg.norm(points[:, :2], axis=1).max() < arm.length + len(arm.modules) * 3 * density.pixel


def test_it_agrees_with_enumeration():
    arm = paper_arm(6)
    density = by_convolution(arm, 0.01, 400_000, 64)
    views = [smoothed(*points, 0.2, 16, arm.length) for points in (convolved_points(density), enumerated_points(arm))]
    assert total_variation(*views) < 0.02
    assert rank_correlation(*views) > 0.98


@pytest.mark.parametrize("modules", [16, 15])
def test_it_agrees_with_the_mapping_algorithm(modules):
    arm = paper_arm(modules)
    density, densities = by_convolution(arm, 0.01, 400_000, 64), map_oriented(arm, 0.05, 25_000, 0.5)
    views = [smoothed(*points, 0.4, 8, arm.length) for points in (convolved_points(density), mapped_points(densities))]
    assert total_variation(*views) < 0.06
    assert rank_correlation(*views) > 0.97


def test_mass_is_one_and_the_mean_is_that_of_the_arm():
    arm = paper_arm(64)
    density = by_convolution(arm, 0.01, 100_000, 64)
    assert density.shares.sum() == pytest.approx(1, abs=1e-12)
    assert density.shares.min() == 0
    assert density.configurations == pytest.approx(64 * math.log(8))
    assert np.logaddexp.reduce(density.values.astype(float), axis=None) == pytest.approx(64 * math.log(8), rel=1e-5)
    # Modules are independent of each other: the mean tip is the product of the modules' mean frames.
    mean = reduce(np.matmul, [module.frames.mean(axis=0) for module in arm.modules])[:2, 3]
    points, shares = convolved_points(density)
    assert np.abs(shares @ points[:, :2] - mean).max() < density.pixel / 2


def test_doubling_takes_as_many_convolutions_as_the_logarithm(monkeypatch):
    calls, original = [], convolution.convolution

    def counted(*arguments):
        calls.append(original(*arguments))
        return calls[-1]

    monkeypatch.setattr(convolution, "convolution", counted)
    by_convolution(paper_arm(1024), 0.01, 10_000, 16)
    assert len(calls) == 8  # from 4 modules, enumerated, to 1,024
    assert max(density.shares.size for density in calls) <= 10_000


@pytest.mark.parametrize("bounds", [(0, 100, 1), (0.1, 199, 8), (0.1, 100, 0)])
def test_bounds_are_checked(bounds):
    with pytest.raises(ValueError, match="must be positive"):
        by_convolution(paper_arm(1), *bounds)


def test_a_spatial_arm_is_refused():
    with pytest.raises(ValueError, match="planar"):
        by_convolution(spatial_arm(2), 0.1, 1000, 8)
