"""The measure of reachability, and the descent of POP and IPOP."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hyperbit.controller.manipulator.manipulator import Manipulator
from hyperbit.controller.search.descent.paths import DescentTables, descend
from hyperbit.controller.search.method import stage_costs
from hyperbit.controller.workspace.densities import Densities
from hyperbit.controller.workspace.mapping import map_densities
from hyperbit.controller.workspace.reachability import Levels, levels_of, measure, tables_of
from tests.arms import paper_arm, spatial_arm

LEVEL = np.array([[[0.5, 1.5, 2.5], [3.5, -0.1, 5.5]]], dtype=np.float32)  # pixel 0.1, first centre at (1, 2, 0)


def measured(x: float, y: float, z: float = 0.0) -> float:
    shapes, references = np.array([LEVEL.shape]), np.array([[1.0, 2.0, 0.0]])
    return measure(Levels(LEVEL.ravel(), np.array([0, 6]), shapes, references, np.array([0.1])), 0, x, y, z)


@pytest.mark.parametrize(("row", "column"), list(np.ndindex(2, 3)))
@pytest.mark.parametrize("shift", [-0.049, 0, 0.049])
def test_inside_it_is_the_value_of_the_pixel(row, column, shift):
    assert measured(1 + 0.1 * column + shift, 2 + 0.1 * row - shift) == pytest.approx(LEVEL[0, row, column])


@pytest.mark.parametrize(
    ("x", "y", "z", "distance"),
    [
        (0.9, 2, 0, 0.1),
        (0, 2.1, 0, 1.0),
        (1.5, 2.5, 0, 0.5),  # from the corner (1.2, 2.1): 0.3 and 0.4 off
        (1, 1, 0, 1.0),
        (1, 2, 3, 3.0),
        (1e9, 2, 0, 1e9 - 1.2),
    ],
)
def test_outside_it_is_minus_the_distance_to_the_box(x, y, z, distance):
    assert measured(x, y, z) == pytest.approx(-distance)


def test_outside_next_to_an_empty_pixel_that_ones_distance_adds():
    assert measured(1.1, 2.6) == pytest.approx(-0.1 - 0.5)


@given(st.floats(0, 3), st.floats(1, 4))
def test_no_point_outside_is_as_good_as_any_inside(x, y):
    inside = 0.95 <= x <= 1.25 and 1.95 <= y <= 2.15
    assert measured(x, y) >= -0.1001 if inside else measured(x, y) < 0.5


ARMS = {"planar": paper_arm(3), "spatial": spatial_arm(3)}
DENSITIES = {name: map_densities(arm, 0.02, 1 << 18) for name, arm in ARMS.items()}


def descended(manipulator: Manipulator, d: Densities, goal, costs, thresholds, depth: int):
    configuration = np.full(len(manipulator.modules), -1)
    tables = DescentTables(tables_of(manipulator), levels_of(d), costs, depth)
    wanted = descend(tuple(goal.tolist()), tables, thresholds, configuration, None)
    return np.array(wanted), configuration


@pytest.mark.parametrize("name", ARMS)
@settings(max_examples=50)
@given(seed=st.integers(0, 10_000), depth=st.integers(0, 3), asked=st.sampled_from([-np.inf, 0.0, 1.0, 3.0, np.inf]))
def test_each_module_takes_the_branch_that_the_two_criteria_order_first(name, seed, depth, asked):
    manipulator, d = ARMS[name], DENSITIES[name]
    rng = np.random.default_rng(seed)
    goal = rng.uniform(-0.7, 0.7, 3) * [1, 1, manipulator.dimension == 3]
    costs = rng.integers(0, 3, manipulator.bits.shape[:2]).astype(float)
    wanted, configuration = descended(manipulator, d, goal, costs, np.full(4, asked), depth)
    assert (configuration[depth:] == -1).all()
    for i in range(depth):
        rows = []
        for j in range(manipulator.states[i]):
            q = manipulator.rotations[i, j].T @ (goal - manipulator.translations[i, j])
            m = measure(levels_of(d), i + 1, *q)
            # Those that pass first, by cost, then measure; then the others by measure alone.
            rows.append((0, costs[i, j], -m, q) if m >= asked else (1, 0.0, -m, q))
        taken = rows[configuration[i]]
        assert taken[:3] == pytest.approx(min(row[:3] for row in rows), abs=1e-9)
        goal = taken[3]
    assert wanted == pytest.approx(goal)


def test_similarity_counts_modules_that_do_not_remain_and_the_base_most(manipulator):
    """The paper: "the weighted number of modules that remain in the same state as in the previous configuration"."""
    previous = np.random.default_rng(0).integers(0, 8, 16)
    costs = stage_costs("ipop-previous", manipulator, previous)
    weights = np.linspace(2, 1, 16)
    for module in range(16):
        expected = np.full(8, weights[module])
        expected[previous[module]] = 0
        assert costs[module].tolist() == expected.tolist()


def test_contraction_counts_modules_that_are_not_fully_contracted(manipulator):
    """The paper: "the weighted number of modules that are fully contracted (i.e. binary state 0)"."""
    costs = stage_costs("ipop-contracted", manipulator, np.zeros(16, dtype=int))
    assert costs[0].tolist() == [0, 2, 2, 2, 2, 2, 2, 2]
    assert costs[15].tolist() == [0, 1, 1, 1, 1, 1, 1, 1]
    assert not stage_costs("pop", manipulator, np.zeros(16, dtype=int)).any()


def test_our_variant_counts_switches_and_the_base_most(manipulator):
    rng = np.random.default_rng(0)
    previous, other = rng.integers(0, 8, (2, 16))
    costs = stage_costs("ipop-fewest-switches", manipulator, previous)
    module = np.arange(16)
    assert (costs[module, previous] == 0).all()
    own = costs[module, other] / np.linspace(2, 1, 16)
    assert own.sum() == pytest.approx(manipulator.switches(previous, other))
    assert costs[0, previous[0] ^ 1] == 2 * costs[15, previous[15] ^ 1] == 2


def test_our_variant_counts_extended_actuators(manipulator):
    costs = stage_costs("ipop-fewest-extended", manipulator, np.zeros(16, dtype=int))
    assert (costs[:, 0] == 0).all()
    assert costs[0].tolist() == [0, 2, 2, 4, 2, 4, 4, 6]
    assert costs[15].tolist() == [0, 1, 1, 2, 1, 2, 2, 3]
