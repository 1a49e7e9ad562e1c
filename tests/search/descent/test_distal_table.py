"""The distal table against brute force."""

import math

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from hyperbit.controller.manipulator import frames
from hyperbit.controller.manipulator.manipulator import Manipulator
from hyperbit.controller.manipulator.module import transforms
from hyperbit.controller.search.descent import distal_table as table_module
from hyperbit.controller.search.descent.distal_table import (
    DistalSearch,
    Wanted,
    build_distal_table,
    finish,
    lowest,
    nearest,
)
from hyperbit.controller.workspace.reachability import tables_of
from tests.arms import (
    any_frames,
    coordinates,
    every_configuration,
    listed,
    paper_arm,
    planar_modules,
    short_arms,
    spatial_arm,
    spatial_frames,
)

arms = short_arms(planar_modules) | short_arms(listed(spatial_frames, planar=False))
NO_TURN = np.eye(3)
tolerances = st.sampled_from([0.0, 0.05, 0.3, 10.0])


@st.composite
def searches(draw):
    """An arm, a goal (sometimes far away), stage costs and a tolerance."""
    manipulator = draw(arms)
    goal = np.array([draw(coordinates) for _ in range(manipulator.dimension)] + [0.0])[:3]
    goal *= draw(st.sampled_from([1.0, 1.0, 3.0, 100.0]))
    seed = draw(st.integers(0, 1000))
    stage_costs = np.random.default_rng(seed).integers(0, 4, manipulator.bits.shape[:2]).astype(float)
    return manipulator, goal, stage_costs, draw(tolerances)


def run_finish(manipulator, goal, stage_costs, tolerance, rotation=NO_TURN, limit=math.inf, weight=0.0, most=math.inf):
    """Returns squared error, whether it is within the tolerance, and configuration of `finish`."""
    search = DistalSearch(build_distal_table(manipulator), stage_costs, tables_of(manipulator))
    configuration = np.zeros(len(manipulator.modules), dtype=np.int64)
    square, within = finish(goal, Wanted(rotation, tolerance, limit, weight), most, search, configuration, None)
    return square, within, configuration


def run_nearest(manipulator, goal, stage_costs, best_cost, best_square):
    """Returns row, cost and squared distance of `nearest` without tolerance."""
    search = DistalSearch(build_distal_table(manipulator), stage_costs, tables_of(manipulator))
    anyhow = Wanted(NO_TURN, 0.0, math.inf, 0.0)
    return nearest(tuple(goal.tolist()), anyhow, best_cost, best_square, search, None)


def total_cost(stage_costs, configurations):
    """Stage costs of configurations (n, B)."""
    return stage_costs[np.arange(len(stage_costs)), configurations].sum(axis=1)


def check_finish(manipulator, goal, stage_costs, tolerance):
    """Compares `finish` with the best of all configurations."""
    square, within, configuration = run_finish(manipulator, goal, stage_costs, tolerance)
    error = math.sqrt(square)
    every = every_configuration(manipulator)
    errors = np.linalg.norm(manipulator.tips(every)[:, :3, 3] - goal, axis=1)
    assert error == pytest.approx(np.linalg.norm(manipulator.tip(configuration)[:3, 3] - goal), abs=1e-9)
    good = errors <= tolerance
    assert within == good.any()
    if good.any():
        costs = total_cost(stage_costs, every)
        assert total_cost(stage_costs, configuration[None])[0] == costs[good].min()
        assert error == pytest.approx(errors[good & (costs == costs[good].min())].min(), abs=1e-9)
    else:
        assert error == pytest.approx(errors.min(), abs=1e-9)


@settings(max_examples=100)
@given(searches())
def test_finish_takes_the_least_penalty_within_tolerance_or_else_the_nearest(search):
    check_finish(*search)


@settings(max_examples=100)
@given(searches(), any_frames, st.floats(0.01, 3.0))
def test_finish_does_so_of_poses(search, frame, turn):
    manipulator, goal, stage_costs, tolerance = search
    rotation = np.ascontiguousarray(frame[:3, :3])
    weight, limit = 0.3, (2 * math.sin(turn / 2)) ** 2
    square, within, configuration = run_finish(manipulator, goal, stage_costs, tolerance, rotation, limit, weight)
    every = every_configuration(manipulator)
    tips = manipulator.tips(every)
    away = ((tips[:, :3, 3] - goal) ** 2).sum(axis=1)
    chords = ((tips[:, :3, :3] - rotation) ** 2).sum(axis=(1, 2)) / 2
    missed = away + weight**2 * chords
    assume(np.abs(np.sqrt(away) - tolerance).min() > 1e-9 and np.abs(chords - limit).min() > 1e-9)
    good = (away <= tolerance**2) & (chords <= limit)
    assert within == good.any()
    if within:
        costs = total_cost(stage_costs, every)
        assert total_cost(stage_costs, configuration[None])[0] == costs[good].min()
        missed = missed[good & (costs == costs[good].min())]
    assert square == pytest.approx(missed.min(), abs=1e-9)
    bounded = run_finish(manipulator, goal, stage_costs, tolerance, rotation, limit, weight, square + 1e-6)
    assert bounded[0] == square
    assert bounded[2].tolist() == configuration.tolist()
    nothing = run_finish(manipulator, goal, stage_costs, tolerance, rotation, limit, weight, missed.min() * 0.999)
    assert within or nothing[:2] == (missed.min() * 0.999, False)


@settings(max_examples=100)
@given(searches(), st.sampled_from([2, 8, 30]), st.sampled_from([1, 6, 40]))
def test_finish_does_so_however_the_arm_is_cut(search, most_points, most_branches):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(table_module, "MOST_POINTS", most_points)
        patch.setattr(table_module, "MOST_BRANCHES", most_branches)
        manipulator, goal, stage_costs, tolerance = search
        t = build_distal_table(manipulator)
        assert t.depth - t.root == 0 or math.prod(manipulator.states[t.root : t.depth].tolist()) <= most_branches
        assert len(t.points) <= max(most_points, manipulator.states[-1])
        # The modules before the root are the densities' to decide: leave them out.
        check_finish(Manipulator(manipulator.modules[t.root :]), goal, stage_costs[t.root :], tolerance)


@settings(max_examples=100)
@given(searches())
def test_nearest_without_tolerance_is_the_nearest_of_all(search):
    manipulator, goal, stage_costs, _ = search
    t = build_distal_table(manipulator)
    row, _, square = run_nearest(manipulator, goal, stage_costs, np.inf, np.inf)
    squares = ((t.points - goal) ** 2).sum(axis=1)
    assert square == pytest.approx(squares.min(), abs=1e-12)
    assert squares[row] == square


@given(searches())
def test_nearest_finds_nothing_better_than_the_best(search):
    manipulator, goal, stage_costs, _ = search
    t = build_distal_table(manipulator)
    best = ((t.points - goal) ** 2).sum(axis=1).min()
    assume(best > 0)  # an exact hit is within any tolerance
    assert run_nearest(manipulator, goal, stage_costs, np.inf, best * 0.999)[0] == -1
    assert run_nearest(manipulator, goal, stage_costs, -1.0, np.inf)[0] == -1


@given(arms)
def test_the_table_holds_the_tips_in_the_order_of_their_number(manipulator):
    t = build_distal_table(manipulator)
    upper = Manipulator(manipulator.modules[t.depth :])
    assert_allclose(t.points, upper.tips(every_configuration(upper))[:, :3, 3], atol=1e-12)
    assert sorted(t.order.tolist()) == list(range(len(t.points)))
    assert t.starts[0] == 0
    assert t.starts[-1] == len(t.points)


@given(st.tuples(*[st.floats(-12, 0)] * 3), st.integers(0, 100))
def test_thin_and_flat_tables_have_few_cells(exponents, seed):
    sizes = 10.0 ** np.array(exponents)
    positions = np.random.default_rng(seed).uniform(0, 1, (500, 3)) * sizes
    t = build_distal_table(Manipulator([transforms([frames.spatial(p) for p in positions], planar=False)]))
    assert t.shape.prod() <= 8 * len(t.points)


def test_a_table_of_one_point_over_and_over():
    same = transforms([frames.planar(0.1, 0.2)] * 3, planar=True)
    square, _, _ = run_finish(Manipulator([same, same]), np.array([0.2, 0.4, 0.0]), np.zeros((2, 3)), 1e-9)
    assert square == pytest.approx(0, abs=1e-24)


@pytest.mark.parametrize(
    ("states", "top", "most", "expected"),
    [
        ([8] * 16, 15, 1 << 16, 11),  # 8^5 <= 2^16 < 8^6
        ([8] * 16, 11, 64, 9),  # 8^2 <= 64
        ([8] * 16, 11, 7, 11),
        ([8], 0, 1 << 16, 0),
        ([100_000], 0, 1 << 16, 0),
        ([2, 100_000], 1, 1 << 16, 1),
        ([2, 3, 4, 5], 3, 20, 2),
        ([2, 3, 4, 5], 3, 60, 1),
        ([2, 3, 4, 5], 3, 1000, 0),
        ([2, 3, 4, 5], 2, 6, 0),
        ([2, 3, 4, 5], 2, 5, 1),
    ],
)
def test_lowest(states, top, most, expected):
    assert lowest(np.array(states), top, most) == expected


@pytest.mark.parametrize("manipulator", [paper_arm(16), spatial_arm(9)], ids=["planar", "spatial"])
def test_real_tables_are_as_long_as_allowed(manipulator):
    t = build_distal_table(manipulator)
    longer = math.prod(manipulator.states[t.depth - 1 :].tolist())
    assert len(t.points) <= table_module.MOST_POINTS < longer
    assert t.shape.prod() <= 2 * len(t.points)
