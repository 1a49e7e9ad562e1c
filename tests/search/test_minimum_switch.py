"""Minimum switch against brute force, on arms with few configurations."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hyperbit.controller.manipulator.frames import planar
from hyperbit.controller.manipulator.manipulator import Manipulator
from hyperbit.controller.manipulator.module import transforms
from hyperbit.controller.manipulator.vgt import vgt
from hyperbit.controller.search.lists.matching import put
from hyperbit.controller.search.lists.segment import Sets, build_segment, motions, room
from hyperbit.controller.search.lists.two_list import middle
from hyperbit.controller.search.solver import Solver
from hyperbit.controller.workspace.mapping import map_densities
from tests.arms import every_configuration, modules, paper_arm, spatial_arm
from tests.search.worlds import solver_of


def all_tips(arm: Manipulator) -> np.ndarray:
    """All tips (n, 3), in mixed-radix order of the states, first module most significant."""
    points = np.zeros((1, 3))
    for i in reversed(range(len(arm.states))):
        k = arm.states[i]
        points = (points @ arm.rotations[i, :k].transpose(0, 2, 1) + arm.translations[i, :k, None]).reshape(-1, 3)
    return points


@pytest.fixture(scope="module")
def arm_of_20_actuators() -> tuple[Manipulator, np.ndarray, np.ndarray]:
    """An arm, all its tips (n, 3), and their order along x (n,)."""
    bend = [planar(x, 0.2, -3 * x) for x in (-0.1, -0.03, 0.04, 0.1)]
    arm = Manipulator([*paper_arm(6).modules, transforms(bend, planar=True)])
    tips = all_tips(arm)
    return arm, tips, np.argsort(tips[:, 0])


@pytest.mark.parametrize("weighted", [False, True])
def test_brute_force_agrees_on_100_goals_of_20_actuators(arm_of_20_actuators, weighted):
    arm, tips, order = arm_of_20_actuators
    assert len(arm.actuators) == 20
    rng = np.random.default_rng(6)
    weights = rng.uniform(1.0, 3.0, 20) if weighted else np.ones(20)
    solver = solver_of(arm, weights)
    xs = tips[order, 0]
    previous = np.zeros(7, dtype=np.int64)
    for goal in tips[rng.integers(0, len(tips), 100), :2]:
        near = order[slice(*np.searchsorted(xs, (goal[0] - 0.006, goal[0] + 0.006)))]
        near = near[np.linalg.norm(tips[near, :2] - goal, axis=1) <= 0.005]
        within = np.column_stack(np.unravel_index(near, tuple(arm.states)))
        states = np.concatenate([arm.bits[i, within[:, i], : len(m.actuators)] for i, m in enumerate(arm.modules)], 1)
        least = ((states != arm.actuator_states(previous)) @ weights).min()
        found = solver.solve(solver.target(goal, 0.005), previous, timeout=60.0)
        assert found.cost == pytest.approx(least)
        assert found.optimal
        previous = found.configuration


def test_goals_in_sequence_are_met_proven_and_cheaper_than_ipop(arm, densities):
    solver = Solver(arm.manipulator, densities)
    rng = np.random.default_rng(3)
    goals = arm.manipulator.tips(rng.integers(0, 8, (60, 16)))[:, :2, 3]
    previous = np.zeros(16, dtype=np.int64)
    proven = 0
    for goal in goals:
        ipop = solver.solve(solver.target(goal, 0.002), previous, "ipop-fewest-switches")
        found = solver.solve(solver.target(goal, 0.002), previous, timeout=10.0)
        assert found.within_tolerance
        assert found.bound <= found.cost == found.switches <= ipop.switches
        proven += found.optimal
        previous = found.configuration
    assert proven >= 54


def test_what_was_expected_changes_nothing_but_the_time(arm, densities):
    """Preparation from this or another configuration, complete or interrupted, for this or another tolerance."""
    plain, expecting = (Solver(arm.manipulator, densities) for _ in range(2))
    rng = np.random.default_rng(5)
    previous = np.zeros(16, dtype=np.int64)
    for k, goal in enumerate(arm.manipulator.tips(rng.integers(0, 8, (24, 16)))[:, :2, 3]):
        centre = previous if k % 2 else rng.integers(0, 8, 16)
        for step, _ in enumerate(expecting.expect(centre, (0.002, 0.005)[k % 3 == 0])):
            if step == k % 5:
                break
        found, same = (s.solve(s.target(goal, 0.002), previous, timeout=10.0) for s in (plain, expecting))
        assert same.configuration.tolist() == found.configuration.tolist()
        assert same.lower_bound == found.lower_bound
        previous = found.configuration


def test_no_time_at_all_still_gives_ipops_answer_or_better(arm, densities):
    solver = Solver(arm.manipulator, densities)
    previous = np.zeros(16, dtype=np.int64)
    found = solver.solve(solver.target((0.55, 2.9), 0.002), previous, timeout=0.0)
    assert found.within_tolerance
    assert found.switches <= solver.solve(solver.target((0.55, 2.9), 0.002), previous, "ipop-fewest-switches").switches


def test_heavy_actuators_rest(arm, densities):
    """If switches of the lower half cost more, there are fewer of them than with equal weights."""
    weights = np.where(np.arange(48) < 24, 10.0, 1.0)
    previous = np.zeros(16, dtype=np.int64)
    rng = np.random.default_rng(8)
    goals = arm.manipulator.tips(rng.integers(0, 8, (4, 16)))[:, :2, 3]

    def lower_switches(solver: Solver) -> int:
        found = [solver.solve(solver.target(goal, 0.002), previous, timeout=10.0).configuration for goal in goals]
        return sum(int(arm.manipulator.actuator_states(c)[:24].sum()) for c in found)

    dear = lower_switches(Solver(arm.manipulator, densities, weights))
    assert dear < lower_switches(Solver(arm.manipulator, densities))


def test_a_goal_out_of_reach_gives_the_nearest_found_and_says_so(arm, densities):
    solver = Solver(arm.manipulator, densities)
    found = solver.solve(solver.target((6.0, 6.0), 0.002), np.zeros(16, dtype=np.int64))
    assert not found.within_tolerance
    assert not found.optimal
    assert found.error == pytest.approx(np.linalg.norm(found.tip[:2, 3] - (6.0, 6.0)))


def test_long_and_spatial_arms():
    for arm, tolerance in ((paper_arm(64), 0.01), (spatial_arm(16), 0.02)):
        rng = np.random.default_rng(4)
        solver = Solver(arm, map_densities(arm, arm.length / 100, 20_000))
        previous = rng.integers(0, arm.states)
        for _ in range(3):
            goal = arm.tip(rng.integers(0, arm.states))[: arm.dimension, 3]
            ipop = solver.solve(solver.target(goal, tolerance), previous, "ipop-fewest-switches")
            found = solver.solve(solver.target(goal, tolerance), previous)
            assert found.within_tolerance >= ipop.within_tolerance
            assert not ipop.within_tolerance or found.cost <= ipop.cost
            assert found.bound <= found.cost or not found.within_tolerance
            previous = found.configuration


@given(st.lists(modules, min_size=1, max_size=4), st.integers(0, 2**32 - 1), st.integers(1, 400))
@settings(max_examples=40)
def test_a_segment_lists_all_that_is_nearer_than_what_it_leaves_out(chain, seed, rows):
    arm = Manipulator(chain)
    rng = np.random.default_rng(seed)
    centre = rng.integers(0, arm.states)
    weights = arm.per_module(rng.uniform(0.5, 2.0, len(arm.actuators)))
    own = arm.bits[np.arange(len(chain)), centre]
    distances = ((arm.bits != own[:, None]) * weights[:, None]).sum(axis=2).astype(float)
    frames = motions(arm)
    sets = Sets(frames, arm.states, centre, distances, distances)
    segment = build_segment(sets, room(rows + 1, frames.shape[1]), 0, len(chain))
    listed = np.tile(centre, (len(segment.costs), 1))
    for row, configuration in enumerate(listed):
        put(configuration, centre, segment.side(), row)
    assert len(np.unique(listed, axis=0)) == len(listed) <= max(rows, 1)
    d = arm.dimension
    np.testing.assert_allclose(arm.tips(listed)[:, :d, 3], segment.frames[:, :d], atol=1e-9)
    axes = arm.tips(listed)[:, :d, 0] if arm.planar else arm.tips(listed)[:, :3, :3].reshape(-1, 9)
    np.testing.assert_allclose(axes, segment.frames[:, d:], atol=1e-9)
    module = np.arange(len(chain))
    np.testing.assert_allclose(distances[module, listed].sum(axis=1), segment.costs, atol=1e-9)
    if np.prod(arm.states.astype(float)) <= 2000:
        everything = distances[module, every_configuration(arm)].sum(axis=1)
        assert (everything < segment.unexplored - 1e-9).sum() == (segment.costs < segment.unexplored - 1e-9).sum()
        assert segment.unexplored == np.inf or np.isclose(everything, segment.unexplored).any()


def test_an_arm_is_cut_into_like_numbers_of_configurations():
    assert middle(paper_arm(16), 0, 16) == 8
    assert middle(paper_arm(16), 8, 16) == 12
    assert middle(paper_arm(1), 0, 1) in (0, 1)
    lengths = [(0.2, 0.25)] * 3
    assert Manipulator([vgt("BC", 0.2, *lengths)]).states.tolist() == [8]


def test_the_beam_saves_a_long_arm_most_of_ipops_switches():
    arm = paper_arm(48)
    solver = Solver(arm, map_densities(arm, arm.length / 300, 60_000))
    rng = np.random.default_rng(9)
    previous = rng.integers(0, arm.states)
    saved = []
    for _ in range(3):  # each takes up to 5 s
        goal = arm.tip(rng.integers(0, arm.states))[:2, 3]
        ipop = solver.solve(solver.target(goal, 0.005), previous, "ipop-fewest-switches")
        found = solver.solve(solver.target(goal, 0.005), previous, timeout=10.0)
        assert found.within_tolerance
        saved.append(found.switches / ipop.switches)
        previous = found.configuration
    assert np.mean(saved) < 0.5
