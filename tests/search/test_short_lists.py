"""Searches whose lists end at 64 rows, on arms of a few thousand configurations that another solver lists whole.

So the rests that lists leave out, bands, and the keys by which lists are used again decide on the certificates.
"""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from hyperbit.controller.manipulator.manipulator import Manipulator
from hyperbit.controller.search.lists.two_list import ListSizes, TwoList
from hyperbit.controller.search.method import distances
from hyperbit.controller.search.search_time import search_effort
from hyperbit.controller.search.solver import Solver
from hyperbit.controller.workspace.mapping import map_densities
from tests.arms import paper_arm, spatial_arm

SIZES = (
    ListSizes(near=64, wide=80, widest=100, quarter=64, layer=16, at_once=64, matched=4),
    ListSizes(near=24, wide=48, widest=64, quarter=8, layer=1, at_once=8, matched=2),
)
ARMS = {  # the same ones for all sizes, so that each is mapped once
    "truss": paper_arm(4),
    "truss of unequal halves": Manipulator([*paper_arm(4).modules, spatial_arm(1).modules[0]][-4:]),
    "spatial": spatial_arm(5),
}
EFFORTS = (0.5, 5.0, 60.0)
LISTING = (0.30, 0.33)  # a deadline between these comes while lists are matched


@pytest.mark.parametrize("sizes", SIZES, ids=lambda sizes: f"near {sizes.near}")
@pytest.mark.parametrize("weighted", [False, True])
@pytest.mark.parametrize("name", ARMS)
def test_what_lists_leave_out_is_never_claimed(name: str, weighted: bool, sizes: ListSizes) -> None:
    """Goals in sequence, at changing deadlines, from present and other configurations, expected or not."""
    arm = ARMS[name]
    rng = np.random.default_rng(7)
    densities = map_densities(arm, arm.length / 20, 2000)
    weights = rng.choice((0.3, 1.0, 1.7, 4.0), len(arm.actuators)) if weighted else None
    whole, short = Solver(arm, densities, weights), Solver(arm, densities, weights, list_whole=False, list_sizes=sizes)
    assert whole.enumeration is not None
    previous, proven = rng.integers(0, arm.states), 0
    for k in range(100):
        effort = rng.uniform(*LISTING) if k % 2 else float(rng.choice(EFFORTS))
        previous = previous if k % 3 else rng.integers(0, arm.states)
        goal = arm.tip(rng.integers(0, arm.states))[: arm.dimension, 3]
        goal += rng.normal(0, 0.02, arm.dimension) * (k % 2)
        tolerance = float(rng.choice((0.002, 0.01, 0.05)))
        if k % 4 == 0:
            for _ in itertools.islice(short.expect(rng.integers(0, arm.states), tolerance), k % 7):
                pass
        told = whole.solve(whole.target(goal, tolerance), previous, timeout=60.0)
        found = short.solve(short.target(goal, tolerance), previous, timeout=search_effort(effort))
        least = told.cost if told.within_tolerance else np.inf
        assert found.bound <= least + 1e-9, (k, found.certificate)
        if found.within_tolerance:
            assert least - 1e-9 <= found.cost
        if found.certificate == "optimal":
            assert found.cost == pytest.approx(least)
        if found.certificate == "unreachable":
            assert least == np.inf
        proven += found.certificate in ("optimal", "unreachable")
        previous = found.configuration
    assert proven >= 5, "it is not silence that makes certificates true"


def test_lists_of_other_costs_or_lengths_are_listed_anew() -> None:
    arm, rng = paper_arm(4), np.random.default_rng(3)
    used, seed = TwoList(arm, 64), rng.integers(0, arm.states)
    away = distances(arm, seed)
    for most in (64, 20, None):
        for costs in (away, away * rng.uniform(0.5, 2.0, away.shape), away):
            fresh = TwoList(arm, 64)
            for lists in (used, fresh):
                lists.list(seed, away, costs, most)
            for half, same in ((used.lower, fresh.lower), (used.upper, fresh.upper)):
                np.testing.assert_allclose(half.costs, same.costs)
                assert half.unexplored == pytest.approx(same.unexplored)
