"""Area within a radius of the tips and density over it, against a fine grid of positions and a list of all tips."""

import math

import numpy as np
import pytest
from scipy.spatial import cKDTree

from hyperbit.controller.manipulator.frames import planar, spatial
from hyperbit.controller.manipulator.joints import prismatic, revolute
from hyperbit.controller.manipulator.manipulator import Manipulator
from hyperbit.controller.workspace import nearby_counts
from hyperbit.controller.workspace.coverage import Coverage, coverage_of
from hyperbit.controller.workspace.mapping import map_densities
from tests.arms import every_tip

WITHIN = 0.1  # of the area, and of the median count


def random_arm(seed: int) -> tuple[Manipulator, float]:
    """A planar or spatial arm of 2^12 configurations, and a radius; the radius of odd seeds leaves gaps."""
    random, solid, sparse = np.random.default_rng(seed), seed % 5 == 4, seed % 2 == 1
    modules = []
    for i in range(6):
        axis = np.eye(3)[i % 3] if solid else (0, 0, 1)
        angles = np.sort(random.uniform(-0.6, 0.6, 4 if i % 2 else 2)).tolist()
        link = random.uniform(0.1, 0.3, 3) if solid else (*random.uniform(-0.05, 0.05, 1), 0.2, 0.0)
        modules.append(revolute(axis, angles, spatial(link)))
    strokes = random.uniform(0.02, 0.2, 3).tolist()
    modules += [prismatic((0, 1, 0), [0.0, stroke], spatial((0.05, 0.0, 0.0))) for stroke in strokes]
    arm = Manipulator(modules, spatial((1, 2, 3)) if solid else planar(1, 2, 0.5))
    tips = every_tip(Manipulator(modules))
    size = float(np.prod(np.ptp(tips, axis=0)[: arm.dimension])) ** (1 / arm.dimension)
    return arm, size * ((0.02 if solid else 0.004) if sparse else (0.06 if solid else 0.03))


def gridded(arm: Manipulator, radius: float) -> tuple[float, float]:
    """Area and median count by a grid of positions, a fraction of the radius apart."""
    size = arm.dimension
    tips = every_tip(Manipulator(arm.modules))[:, :size]
    step = radius / (6 if size == 2 else 3)
    near = np.stack(np.meshgrid(*[np.arange(-radius, radius + step, step)] * size, indexing="ij"), -1).reshape(-1, size)
    low = tips.min(axis=0) - 2 * radius
    shape = np.ceil((tips.max(axis=0) - low) / step).astype(int) + 20
    keys = [np.ravel_multi_index(np.round((tips + shift - low) / step).astype(int).T, shape) for shift in near]
    cells = np.column_stack(np.unravel_index(np.unique(np.concatenate(keys)), shape)) + low / step
    counts = cKDTree(tips).query_ball_point(cells * step, radius, return_length=True)
    found = counts[counts > 0]
    return len(found) * step**size, float(np.median(found))


def assert_agrees(found: Coverage, area: float, median: float) -> None:
    assert found.area.lower <= found.area.upper
    assert found.area.middle == pytest.approx(area, rel=WITHIN)
    assert 10**found.log10_median.lower <= median * (1 + WITHIN)
    assert 10**found.log10_median.upper >= median * (1 - WITHIN)
    assert 10**found.log10_median.middle == pytest.approx(median, rel=WITHIN)


@pytest.mark.parametrize("seed", range(5))
def test_figures_agree_with_all_configurations(seed: int) -> None:
    arm, radius = random_arm(seed)
    found = coverage_of(arm, map_densities(arm, 0.03, 1 << 16), radius)
    assert found.method == "listing"
    assert_agrees(found, *gridded(arm, radius))


@pytest.mark.parametrize("seed", [0, 1, 4, 9])
def test_figures_do_not_depend_on_the_pixel(seed: int) -> None:
    arm, radius = random_arm(seed)
    fine, coarse = (coverage_of(arm, map_densities(arm, pixel, 1 << 16), radius) for pixel in (0.01, 0.1))
    assert fine.area.middle == pytest.approx(coarse.area.middle, rel=WITHIN)
    assert 10**fine.log10_median.middle == pytest.approx(10**coarse.log10_median.middle, rel=WITHIN)


@pytest.mark.parametrize("seed", [0, 1, 4])
def test_two_halves_count_as_one_list(seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(nearby_counts, "LISTED", 100)
    arm, radius = random_arm(seed)
    found = coverage_of(arm, map_densities(arm, 0.03, 1 << 16), radius)
    assert found.method == "halves"
    assert_agrees(found, *gridded(arm, radius))


@pytest.mark.parametrize("seed", [0, 1])
def test_draws_bound_the_area_from_both_sides(seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    for name, most in (("LISTED", 100), ("LISTED_FOR_DRAWS", 100), ("COMPARED", 4)):
        monkeypatch.setattr(nearby_counts, name, most)
    arm, radius = random_arm(seed)
    found = coverage_of(arm, map_densities(arm, 0.03, 1 << 16), radius)
    area, median = gridded(arm, radius)
    assert found.method == "draws"
    assert found.area.lower * (1 - WITHIN) <= area <= found.area.upper * (1 + WITHIN)
    assert found.log10_median.lower - 0.1 <= math.log10(median) <= found.log10_median.upper + 0.1


def test_coinciding_tips_cover_no_more_than_one() -> None:
    arm = Manipulator([prismatic((1, 0, 0), [0.0, 0.1], np.eye(4))] * 12)  # 13 places for 4096 configurations
    found = coverage_of(arm, map_densities(arm, 0.01, 1 << 16), 0.02)
    assert found.area.middle == pytest.approx(13 * math.pi * 0.02**2, rel=WITHIN)
    assert found.log10_greatest == pytest.approx(math.log10(math.comb(12, 6)))
    assert found.densest[:2] == pytest.approx((0.6, 0.0), abs=0.02)


def test_a_radius_above_the_arm_takes_all_configurations() -> None:
    arm, _ = random_arm(0)
    found = coverage_of(arm, map_densities(arm, 0.03, 1 << 16), 100.0)
    assert found.area.middle == pytest.approx(math.pi * 100**2, rel=WITHIN)
    assert found.log10_median.middle == pytest.approx(found.log10_configurations) == pytest.approx(12 * math.log10(2))


def test_long_arms_have_more_configurations_than_floats(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(nearby_counts, "LISTED_FOR_DRAWS", 100)
    monkeypatch.setattr(nearby_counts, "DRAWS", 20)
    arm = Manipulator(
        [prismatic((1, 0, 0), [0.0, 0.1], np.eye(4)), revolute((0, 0, 1), [-0.1, 0.1], planar(0, 0.1))] * 600
    )
    found = coverage_of(arm, map_densities(arm, 0.5, 1 << 12), 0.5, positions=64)
    assert found.log10_configurations == pytest.approx(1200 * math.log10(2))
    assert 0 < found.area.lower <= found.area.upper
    assert 250 < found.log10_median.lower <= found.log10_median.upper < 361
