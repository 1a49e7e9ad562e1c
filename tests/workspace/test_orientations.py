"""Orientations at a point, against enumeration of short arms."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hyperbit.controller.manipulator.frames import planar, spatial
from hyperbit.controller.manipulator.manipulator import Manipulator
from hyperbit.controller.workspace import orientations as module
from hyperbit.controller.workspace.mapping import map_densities
from hyperbit.controller.workspace.orientations import Orientations, orientations_at
from tests.arms import any_frames, every_configuration, paper_arm, short_arms, spatial_arm


def nearby(manipulator: Manipulator, point: np.ndarray, radius: float) -> np.ndarray:
    """Orientations (n, 3, 3) of all configurations whose tip is within a radius of a point."""
    tips = manipulator.tips(every_configuration(manipulator))
    near = np.linalg.norm(tips[:, : manipulator.dimension, 3] - point, axis=1) <= radius
    return tips[near, :3, :3]


def in_order(rotations: np.ndarray) -> np.ndarray:
    rows = rotations.reshape(-1, 9).round(9)
    return rows[np.lexsort(rows.T)]


@settings(max_examples=60, deadline=None)
@given(short_arms(bases=any_frames), st.integers(0, 2**32))
def test_short_arms_are_enumerated(manipulator, seed):
    chosen = np.random.default_rng(seed).integers(0, manipulator.states)
    point = manipulator.tip(chosen)[: manipulator.dimension, 3]
    found = orientations_at(manipulator, map_densities(manipulator, 0.05, 1 << 14), point, 0.03)
    expected = nearby(manipulator, point, 0.03)
    assert np.allclose(in_order(found.rotations), in_order(expected), atol=1e-8)
    assert (found.total, found.deviation, found.draws) == (len(expected), 0.0, 0)
    assert (found.counts == 1).all()


ARMS = {
    "planar": Manipulator(paper_arm(6).modules, planar(0.3, -0.2, 0.7)),
    "spatial": Manipulator(spatial_arm(6).modules, spatial((0.1, 0.2, 0.3), (0.3, 0.1, 0.2, 0.9))),
}


@pytest.mark.parametrize("kind", ARMS)
@pytest.mark.parametrize("seed", range(4))
def test_draws_count_what_enumeration_counts(kind, seed, monkeypatch):
    monkeypatch.setattr(module, "ENUMERATED", 100)
    arm = ARMS[kind]
    densities = map_densities(arm, 0.03, 1 << 16)
    chosen = np.random.default_rng(seed).integers(0, arm.states)
    point = arm.tip(chosen)[: arm.dimension, 3]
    expected = nearby(arm, point, 0.02)
    found = orientations_at(arm, densities, point, 0.02, most=100_000, seed=seed)
    assert found.draws > 0
    assert found.total == pytest.approx(len(expected), abs=6 * found.deviation)
    assert found.deviation < 0.1 * found.total
    assert found.total == pytest.approx(found.counts.sum())
    mean = np.tensordot(found.counts, found.rotations, 1) / found.total
    assert np.allclose(mean, expected.mean(axis=0), atol=0.1)


def test_draws_are_not_lost_where_densities_miss_a_state(monkeypatch):
    """With the densities of an arm with fewer states, configurations that they exclude are still found and counted."""
    monkeypatch.setattr(module, "ENUMERATED", 8)
    arm = paper_arm(4)
    point = arm.tip(np.array([7, 7, 7, 7]))[:2, 3]
    wrong = map_densities(paper_arm(4), 0.02, 1 << 14)
    values = wrong.values.copy()
    values[values >= 0] = -0.02  # nothing can be reached anywhere
    blind = type(wrong)(values, wrong.offsets, wrong.shapes, wrong.references, wrong.pixels)
    found = orientations_at(arm, blind, point, 0.02, most=50_000)
    expected = len(nearby(arm, point, 0.02))
    assert expected > 0
    assert found.total == pytest.approx(expected, abs=max(6 * found.deviation, 1e-9))


def test_nothing_is_found_out_of_reach():
    arm = ARMS["planar"]
    found = orientations_at(arm, map_densities(arm, 0.05, 1 << 14), (9.0, 9.0), 0.02, most=5000)
    assert (found.total, len(found.rotations)) == (0.0, 0)


def test_mean_and_spread():
    turns = np.array([planar(0, 0, angle)[:3, :3] for angle in (0.1, 0.3)])
    found = Orientations(turns, np.array([1.0, 1.0]), 2.0, 0.0, 0)
    assert math.atan2(found.mean[1, 0], found.mean[0, 0]) == pytest.approx(0.2)
    assert found.spread == pytest.approx(0.1)
