"""Cost-to-go maps are lower bounds at every point, of every level, for any weights and radii."""

import numpy as np
import pytest

from hyperbit.controller.manipulator.frames import planar
from hyperbit.controller.manipulator.manipulator import Manipulator
from hyperbit.controller.manipulator.module import transforms
from hyperbit.controller.workspace.cost_to_go import UNREACHABLE, CostToGo, Maps
from hyperbit.controller.workspace.hull import Hull
from tests.arms import every_configuration, paper_arm


def value(maps: Maps, level: int, point: np.ndarray) -> float:
    u, v = np.floor((point - maps.corners[level]) / maps.pixels[level]).astype(int)
    nx, ny = maps.shapes[level]
    if not (0 <= u < nx and 0 <= v < ny):
        return np.inf
    found = maps.values[maps.offsets[level] + u * ny + v]
    return np.inf if found >= UNREACHABLE else maps.unit * float(found)


def any_planar_arm(rng: np.random.Generator) -> Manipulator:
    if rng.random() < 0.3:
        return paper_arm(4)
    sizes = rng.integers(1, 5, rng.integers(2, 6))
    return Manipulator(
        [transforms([planar(*rng.normal(0, 0.3, 2), rng.uniform(-3, 3)) for _ in range(n)], planar=True) for n in sizes]
    )


@pytest.mark.parametrize("seed", range(24))
def test_no_value_is_above_the_least_cost_within_the_radius(seed):
    rng = np.random.default_rng(seed)
    arm = any_planar_arm(rng)
    kinds = ([1.0], [1.0, 1.5], [0.1, 0.3, 0.7], list(rng.uniform(0.1, 3.0, 9)))
    costs = rng.choice(kinds[seed % 4], (len(arm.states), arm.states.max()))
    costs[np.arange(len(arm.states)), rng.integers(0, arm.states)] = 0.0
    to_go = CostToGo(arm, Hull(arm).boxes)
    for radius in (1e-9, float(10.0 ** rng.uniform(-4, -0.5)), 0.3):
        maps = to_go.maps(costs, radius)
        for level in range(maps.first, len(arm.states)):
            above = Manipulator(arm.modules[level:])
            each = every_configuration(above)
            tips = above.tips(each)[:, :2, 3]
            prices = costs[level:][np.arange(len(above.states)), each].sum(axis=1)
            for tip in tips[rng.integers(0, len(tips), 20)]:
                turn = rng.uniform(0, 2 * np.pi)
                point = tip + radius * rng.choice((0.0, 0.5, 0.999999)) * np.array((np.cos(turn), np.sin(turn)))
                near = np.linalg.norm(tips - point, axis=1) <= radius
                least = prices[near].min() if near.any() else np.inf
                assert value(maps, level, point) <= least * (1 + 1e-9)


def test_maps_of_the_papers_arm_bound_what_few_modules_can_do():
    """Far from the tip of the contracted arm, no single switch suffices."""
    arm = paper_arm(8)
    costs = arm.bits.sum(axis=2).astype(float)
    maps = CostToGo(arm, Hull(arm).boxes).maps(costs, 1e-3)
    state = np.full(8, 4)
    tips = np.array([Manipulator(arm.modules[i:]).tip(state[i:])[:2, 3] for i in range(8)])
    values = [value(maps, level, tips[level]) for level in range(maps.first, 8)]
    assert all(0 < v <= 8 - level for level, v in zip(range(maps.first, 8), values, strict=True))
