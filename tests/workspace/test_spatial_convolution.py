"""Convolution on SE(3): its grid of rotations, and densities against enumeration, exact means and the mapping."""

import math
from functools import reduce

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation
from scipy.stats import spearmanr

from controller.manipulator import frames
from controller.manipulator.manipulator import Manipulator
from controller.manipulator.module import transforms
from controller.workspace import doubling, spatial_convolution
from controller.workspace.oriented_mapping import map_oriented
from controller.workspace.rotation_grid import CUBE, RotationGrid, turned
from controller.workspace.spatial_convolution import by_spatial_convolution
from tests.arms import every_configuration, quaternions, short_arms, spatial_arm
from tests.workspace.comparing import (
    drawn_points,
    mapped_positions,
    placed,
    second_moment,
    spatial_points,
    total_variation,
)

GRIDS = {along: RotationGrid(along) for along in (1, 2, 3, 4)}


@given(quaternions, st.sampled_from(list(GRIDS)))
def test_a_rotation_is_shared_so_that_the_mean_is_itself(quaternion, along):
    grid, rotation = GRIDS[along], Rotation.from_quat(quaternion).as_matrix()
    cells, parts = grid.shares(rotation[None])
    assert parts.sum() == pytest.approx(1)
    assert_allclose(np.einsum("k,kab->ab", parts[0], grid.rotations[cells[0]]), rotation, atol=1e-9)
    assert -parts[parts < 0].sum() < 0.6


@pytest.mark.parametrize("along", list(GRIDS))
def test_what_is_in_the_grid_is_shared_with_nobody(along):
    grid = GRIDS[along]
    cells, parts = grid.shares(grid.rotations)
    own = np.zeros((len(grid.rotations),) * 2)
    np.add.at(own, (np.arange(len(own))[:, None], cells), parts)
    assert_allclose(own, np.eye(len(own)), atol=1e-6)
    assert len(own) == 24 * along**3


@pytest.mark.parametrize("along", [1, 2])
def test_the_grid_after_a_lattice_rotation_keeps_all_shares(along):
    grid = GRIDS[along]
    for rotation, after in zip(grid.lattice, grid.after, strict=True):
        assert_allclose(after.sum(axis=0), 1)
        for k in (0, 7, len(grid.rotations) - 1):
            column = after[:, [k]].toarray()[:, 0]
            mean = np.einsum("n,nab->ab", column, grid.rotations)
            assert_allclose(mean, rotation @ grid.rotations[k], atol=1e-9)


@pytest.mark.parametrize("turn", CUBE, ids=str)
def test_the_turns_of_a_cube_exchange_pixels(turn):
    boxes = np.random.default_rng(0).random((2, 5, 5, 5))
    result = turned(boxes, turn)
    for place in ((2, 0, 0), (0, -1, 0), (1, 2, -2)):
        x, y, z = np.round(turn @ place).astype(int)
        px, py, pz = place
        assert (result[:, 2 + z, 2 + y, 2 + x] == boxes[:, 2 + pz, 2 + py, 2 + px]).all()


def lattice(*steps):
    """A module whose states are steps on the integers with turns of the cube, where nothing lies between pixels."""
    states = []
    for place, turn in steps:
        frame = frames.spatial(place)
        frame[:3, :3] = CUBE[turn]
        states.append(frame)
    return transforms(states, planar=False)


A, B = lattice(((0, 0, 1), 3), ((1, 0, 1), 17), ((0, 1, 0), 8)), lattice(((0, 0, 2), 5), ((0, -1, 1), 20))


@pytest.mark.parametrize("modules", [[A] * 6, [A, B] * 3, [A] * 3 + [B] * 2], ids=["6", "3x2", "3+2"])
def test_on_a_lattice_convolution_counts_exactly(modules, monkeypatch):
    monkeypatch.setattr(doubling, "ENUMERATED", 1)
    monkeypatch.setattr(spatial_convolution, "BROAD", 0)
    arm = Manipulator(modules)
    tips = arm.tips(every_configuration(arm))
    counts: dict[tuple[int, ...], int] = {}
    for tip in tips:
        place = (
            int(np.abs(CUBE - tip[:3, :3]).sum(axis=(1, 2)).argmin()),
            *np.round(tip[2::-1, 3]).astype(int).tolist(),
        )
        counts[place] = counts.get(place, 0) + 1
    density = by_spatial_convolution(arm, 1.0, 10**6, 1)
    assert density.pixel == 1
    assert density.configurations == pytest.approx(math.log(len(tips)))
    places = np.array(list(counts)) + np.array([0, 1, 1, 1]) * (density.shares.shape[1] // 2)
    found = density.shares[tuple(places.T)] * len(tips)
    assert_allclose(found, list(counts.values()), rtol=1e-6)
    assert np.abs(density.shares).sum() == pytest.approx(1, rel=1e-6)  # nothing anywhere else
    assert_allclose(density.values[tuple(places.T)], np.log(list(counts.values())), atol=1e-5)


@settings(max_examples=10)
@given(short_arms(), st.sampled_from([0.05, 1.0]))
def test_mean_frame_and_mean_square_distance_are_exact_for_any_arm(arm, pixel):
    along, level_pixels = 1, 100_000
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(doubling, "ENUMERATED", 1)
        patch.setattr(spatial_convolution, "BROAD", 0)
        density = by_spatial_convolution(arm, pixel, level_pixels, along)
    assert density.shares.size <= level_pixels
    assert density.shares.sum() == pytest.approx(1)
    mean = arm.tips(every_configuration(arm)).mean(axis=0)
    points, shares = spatial_points(density)
    scale = arm.length + density.pixel
    assert_allclose(shares @ points, mean[:3, 3], atol=1e-9 * scale)
    assert shares @ (points**2).sum(axis=1) == pytest.approx(second_moment(arm), abs=1e-9 * scale**2)
    rotation = np.einsum("kzyx,kab->ab", density.shares, density.grid.rotations)
    assert_allclose(rotation, mean[:3, :3], atol=1e-9)


@pytest.mark.parametrize(("along", "level_pixels", "count"), [(1, 200_000, 256), (2, 700_000, 32)])
def test_long_arms_keep_their_mean_frame(along, level_pixels, count, monkeypatch):
    monkeypatch.setattr(spatial_convolution, "BROAD", 0)
    arm = spatial_arm(count)
    density = by_spatial_convolution(arm, 0.01, level_pixels, along)
    mean = reduce(np.matmul, [module.frames.mean(axis=0) for module in arm.modules])
    points, shares = spatial_points(density)
    assert_allclose(shares @ points, mean[:3, 3], atol=1e-9 * arm.length)
    assert shares @ (points**2).sum(axis=1) == pytest.approx(second_moment(arm), rel=1e-9)
    assert density.configurations == pytest.approx(count * math.log(6))


def test_segments_that_hardly_turn_are_drawn_and_not_halved(monkeypatch):
    calls, original = [], spatial_convolution.begun

    def counted(segment, *arguments):
        calls.append(len(segment.modules))
        return original(segment, *arguments)

    monkeypatch.setattr(spatial_convolution, "begun", counted)
    monkeypatch.setattr(spatial_convolution, "DRAWN", 2000)
    stiff = [frames.spatial((0, 0, 0.1), (x, y, 0, 1)) for x in (0.02, -0.02) for y in (0.02, -0.02)]
    by_spatial_convolution(Manipulator([transforms(stiff, planar=False)] * 20), 0.01, 100_000, 1)
    assert calls == [20]
    calls.clear()
    by_spatial_convolution(spatial_arm(64), 0.01, 100_000, 1)
    assert calls == [32]  # of variance 1.1 about each axis; so coarse a grid asks for 1.2


def test_it_agrees_with_random_configurations_and_the_mapping_algorithm():
    arm = spatial_arm(16)
    density, densities = by_spatial_convolution(arm, 0.01, 3_000_000, 2), map_oriented(arm, 0.01, 20_000, 1.0)
    convolved, mapped, drawn = (
        placed(*points, arm.length / 6, arm.length)
        for points in (spatial_points(density), mapped_positions(densities), drawn_points(arm, 100_000))
    )
    assert total_variation(convolved, drawn) < 0.1
    assert total_variation(convolved, mapped) < 0.25
    held = drawn > 0.002
    assert spearmanr(convolved[held], drawn[held]).statistic > 0.9


def test_doubling_takes_as_many_convolutions_as_the_logarithm(monkeypatch):
    calls, original = [], spatial_convolution.convolution

    def counted(*arguments):
        calls.append(original(*arguments))
        return calls[-1]

    monkeypatch.setattr(spatial_convolution, "convolution", counted)
    monkeypatch.setattr(spatial_convolution, "BROAD", 0)
    by_spatial_convolution(spatial_arm(1024), 0.01, 100_000, 1)
    assert len(calls) == 8  # from 4 modules, enumerated
    assert max(density.shares.size for density in calls) <= 100_000


@pytest.mark.parametrize("bounds", [(0, 100_000, 1), (0.1, 15**3 * 24 - 1, 1), (0.1, 100_000, 0)])
def test_bounds_are_checked(bounds):
    with pytest.raises(ValueError, match="must be positive"):
        by_spatial_convolution(spatial_arm(1), *bounds)
