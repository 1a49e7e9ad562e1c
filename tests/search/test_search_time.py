"""The time of a search: its first bound, what the proven gap is worth, and the time without an answer."""

import math
import time

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hyperbit.controller.search.search_time import UNFOUND, SearchTime, search_time
from hyperbit.controller.search.solution import Incumbent
from hyperbit.controller.search.solver import Solver
from hyperbit.controller.workspace.mapping import map_densities
from tests.arms import paper_arm

seconds = st.floats(0.0, 100.0)
times = st.builds(SearchTime, seconds, seconds, seconds, seconds)
gaps = st.floats(0.0, 1000.0)
FOREVER = 1e6


class Ended(Exception):
    """The search was told to end."""


@given(times, gaps, gaps)
def test_a_smaller_gap_never_has_more_time(allowed, one, other):
    small, great = sorted((one, other))
    assert allowed.allowed(small) <= allowed.allowed(great) <= allowed.most


@given(times, gaps)
def test_the_time_is_the_first_bound_and_what_the_gap_is_worth(allowed, gap):
    assert allowed.allowed(0.0) == min(allowed.first, allowed.most)
    worth = min(allowed.first + gap * allowed.per_switch, allowed.most)
    assert allowed.allowed(gap) == pytest.approx(worth)
    assert allowed.allowed(math.inf) == min(max(allowed.first, allowed.unfound), allowed.most)


@given(times, st.one_of(st.none(), st.floats(1e-3, 60.0)), gaps)
def test_a_deadline_bounds_all_times(allowed, deadline, gap):
    own = search_time(allowed.first, allowed.per_switch, deadline)
    assert own.allowed(math.inf) == (max(allowed.first, UNFOUND) if deadline is None else deadline)
    assert own.allowed(gap) <= (math.inf if deadline is None else deadline)


@given(times, st.lists(st.tuples(st.booleans(), st.floats(0.0, 50.0)), max_size=8))
def test_the_deadline_of_an_extended_search_follows_cost_and_bound(allowed, steps):
    configuration = np.zeros(2, dtype=np.int64)
    incumbent = Incumbent(configuration, FOREVER, lambda gap: FOREVER + allowed.allowed(gap))
    incumbent.extend()
    for better, value in steps:
        if better:
            incumbent.offer(configuration, value, 0.0)
        else:
            incumbent.prove(value)
        if incumbent.proven:
            break
        assert incumbent.until == FOREVER + allowed.allowed(incumbent.cost - incumbent.bound)


def test_a_hurried_search_ends_only_with_an_answer_beyond_its_first_time():
    configuration = np.zeros(2, dtype=np.int64)
    incumbent = Incumbent(configuration, FOREVER, lambda gap: 2 * FOREVER, lambda: True)
    assert not incumbent.late
    incumbent.extend()
    assert not incumbent.late
    incumbent.offer(configuration, 3.0, 0.0)
    assert incumbent.late


@pytest.fixture(scope="module", params=["prepared", "unprepared"])
def solver(request: pytest.FixtureRequest) -> Solver:
    arm = paper_arm(16)
    solver = Solver(arm, map_densities(arm, 0.05, 4000))
    if request.param == "prepared":
        solver.prepare()
    return solver


def test_a_gap_that_is_worth_it_is_closed(solver):
    """Without any first time a search proves its answers, because a saved switch is worth a minute."""
    rng = np.random.default_rng(3)
    previous = np.zeros(16, dtype=np.int64)
    for goal in solver.manipulator.tips(rng.integers(0, 8, (6, 16)))[:, :2, 3]:
        target = solver.target(goal, 2e-3)
        worthless = solver.solve(target, previous, timeout=SearchTime(0.0))
        worth = solver.solve(target, previous, timeout=SearchTime(0.0, per_switch=60.0, unfound=60.0))
        assert worth.optimal
        assert not worthless.within_tolerance or worth.cost <= worthless.cost


@pytest.mark.parametrize("turn", [math.inf, 0.03])
def test_a_goal_that_is_not_found_in_the_first_time_is_found_later(solver, turn):
    """Each is the tip of a configuration of a sparse place."""
    rng = np.random.default_rng(5)
    previous = rng.integers(0, 8, 16)
    for straight in (np.zeros(16, dtype=np.int64), np.full(16, 7), np.tile((5, 2), 8)):
        tip = solver.manipulator.tip(straight)
        goal = tip if turn < math.inf else tip[:2, 3]
        own = solver.another()
        own.prepare()
        found = own.solve(own.target(goal, 2e-3, turn), previous, timeout=SearchTime(0.0, unfound=600.0))
        assert found.within_tolerance


def test_what_a_check_raises_ends_the_search_and_leaves_the_solver_sound(solver):
    rng = np.random.default_rng(6)
    previous = rng.integers(0, 8, 16)
    goals = solver.manipulator.tips(rng.integers(0, 8, (4, 16)))
    for calls in (1, 2, 5, 20, 50):
        left = [calls]

        def hurried(left: list[int] = left) -> bool:
            left[0] -= 1
            if left[0] <= 0:
                raise Ended
            return False

        with pytest.raises(Ended):
            solver.solve(solver.target(goals[0], 1e-7, 1e-7), previous, timeout=600.0, hurried=hurried)
        for goal in goals:
            again = solver.solve(solver.target(goal[:2, 3], 2e-3), previous, timeout=600.0)
            fresh = solver.another().solve(solver.target(goal[:2, 3], 2e-3), previous, timeout=600.0)
            assert again.within_tolerance
            assert again.cost == fresh.cost == again.bound


def test_a_deadline_bounds_a_search_that_finds_nothing(solver):
    """The search is told the time by its own clock, which the deadline must end."""
    nowhere = solver.target((0.55, 2.9), 1e-9)
    began = time.perf_counter()
    found = solver.solve(nowhere, np.zeros(16, dtype=np.int64), timeout=SearchTime(0.0, 1.0, 3600.0, most=0.05))
    assert not found.within_tolerance
    assert time.perf_counter() - began < 600.0
