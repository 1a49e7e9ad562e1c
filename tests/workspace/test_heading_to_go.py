"""Costs to go of the heading are lower bounds for every heading, of every level, for any weights and tolerances."""

import numpy as np
import pytest

from hyperbit.controller.manipulator.manipulator import Manipulator
from hyperbit.controller.workspace.cost_to_go import UNREACHABLE, in_levels
from hyperbit.controller.workspace.heading_to_go import BINS, PART_BITS, HeadingToGo, parts
from tests.arms import every_configuration, paper_arm
from tests.workspace.test_cost_to_go import any_planar_arm


@pytest.mark.parametrize("seed", range(24))
def test_no_value_is_above_the_least_cost_within_the_angle(seed):
    rng = np.random.default_rng(seed)
    arm = any_planar_arm(rng)
    kinds = ([1.0], [1.0, 1.5], [0.1, 0.3, 0.7], list(rng.uniform(0.1, 3.0, 9)))
    costs = rng.choice(kinds[seed % 4], (len(arm.states), arm.states.max()))
    costs[np.arange(len(arm.states)), rng.integers(0, arm.states)] = 0.0
    unit, levels = in_levels(costs)
    to_go = HeadingToGo(arm)
    for angle in (1e-9, float(10.0 ** rng.uniform(-4, -0.5)), 1.0, 3.1):
        values = to_go.headings(levels, UNREACHABLE, angle).values
        for level in range(len(arm.states)):
            above = Manipulator(arm.modules[level:])
            each = every_configuration(above)
            tips = above.tips(each)
            own = np.arctan2(tips[:, 1, 0], tips[:, 0, 0])
            prices = costs[level:][np.arange(len(above.states)), each].sum(axis=1)
            for heading in own[rng.integers(0, len(own), 20)] + angle * rng.choice((-0.999999, 0.0, 0.5, 0.999999)):
                away = np.abs((own - heading + np.pi) % (2 * np.pi) - np.pi)
                least = prices[away <= angle].min(initial=np.inf)
                level_of = values[level, (int(parts(np.sin(heading), np.cos(heading))) >> PART_BITS) % BINS]
                found = np.inf if level_of >= UNREACHABLE else unit * float(level_of)
                assert found <= least * (1 + 1e-9)


def test_turning_the_tip_of_the_papers_arm_takes_many_switches():
    """No switch turns the heading by more than 0.31 rad, so that a right angle takes at least six."""
    arm = paper_arm(12)
    costs = arm.bits.sum(axis=2).astype(float)
    unit, levels = in_levels(costs)
    values = HeadingToGo(arm).headings(levels, UNREACHABLE, 0.03).values
    assert values[0, 0] == 0
    assert 6 <= unit * values[0, BINS // 4] < 12
    assert values[12, BINS // 4] == UNREACHABLE


def test_any_orientation_has_no_cost():
    arm = paper_arm(2)
    levels = in_levels(np.ones((2, 8)))[1]
    assert HeadingToGo(arm).headings(levels, UNREACHABLE, np.inf).values.shape == (0, BINS)
