"""Lists of all that is near a configuration, against brute force, and what they find for long arms."""

import numpy as np
import pytest

from hyperbit.controller.manipulator.manipulator import Manipulator
from hyperbit.controller.obstacles.clearance import BodyClearance
from hyperbit.controller.obstacles.scene import collides
from hyperbit.controller.search.lists.two_list import ListSizes
from hyperbit.controller.search.method import switch_costs
from hyperbit.controller.search.neighbours.chain import chain_of
from hyperbit.controller.search.neighbours.leaps import Leaps
from hyperbit.controller.search.search_time import search_effort
from hyperbit.controller.search.solution import Incumbent
from hyperbit.controller.search.solver import Solver
from hyperbit.controller.search.target import Problem
from tests.arms import paper_arm, spatial_arm
from tests.obstacles.dense import Disc, obstacles_of
from tests.search.worlds import drawn_arm, drawn_goal, drawn_weights, least_cost, solver_of

LONG = {"planar": paper_arm(48), "spatial": spatial_arm(44)}


def leaps_of(solver: Solver, near: int = 1 << 18, deep: int = 1 << 20) -> Leaps:
    arm = solver.manipulator
    by_switches = chain_of(arm, arm.per_module(np.ones(len(arm.actuators))), 1.0, True)
    return Leaps(solver.chain, by_switches, ListSizes(near_changes=near, deep_changes=deep))


@pytest.mark.parametrize("seed", range(60))
def test_the_nearest_are_those_of_brute_force(seed):
    rng = np.random.default_rng(seed)
    arm = drawn_arm(rng, space=seed % 4 > 1)
    solver, goal = solver_of(arm, drawn_weights(arm, rng)), drawn_goal(arm, rng, posed=seed % 2 == 1)
    previous, target = rng.integers(0, arm.states), solver.target(*goal)
    problem = Problem(target, previous, switch_costs(arm, previous, solver.weights))
    incumbent, leaps = Incumbent(previous, np.inf), leaps_of(solver)
    leaps.prove(problem, incumbent)
    least = least_cost(solver, goal, previous)
    assert incumbent.bound <= least + 1e-9
    if incumbent.cost < np.inf:
        assert target.met(incumbent.configuration)
        assert incumbent.cost == pytest.approx(problem.cost(incumbent.configuration)) == pytest.approx(least)
        assert incumbent.proven
    leaps.improve(problem, incumbent, np.inf)
    assert incumbent.cost == np.inf or target.met(incumbent.configuration)


@pytest.mark.parametrize("seed", range(60))
def test_what_lists_leave_out_for_want_of_room_is_never_claimed(seed):
    rng = np.random.default_rng(seed)
    arm = drawn_arm(rng, space=seed % 4 > 1)
    solver, goal = solver_of(arm, drawn_weights(arm, rng)), drawn_goal(arm, rng, posed=seed % 2 == 1)
    previous, target = rng.integers(0, arm.states), solver.target(*goal)
    problem = Problem(target, previous, switch_costs(arm, previous, solver.weights))
    incumbent, leaps = Incumbent(previous, np.inf), leaps_of(solver, int(rng.integers(1, 9)), int(rng.integers(9, 90)))
    least = least_cost(solver, goal, previous)
    for prove in (leaps.prove, leaps.prove_deep, leaps.prove_deep):
        before = incumbent.bound
        prove(problem, incumbent)
        assert before <= incumbent.bound <= least + 1e-9
        assert least - 1e-9 <= incumbent.cost
        assert incumbent.cost == np.inf or target.met(incumbent.configuration)


def changed(arm: Manipulator, configuration: np.ndarray, switches: int, rng: np.random.Generator) -> np.ndarray:
    """Returns a configuration that differs in so many modules, by one actuator each where an actuator has a bit."""
    other = configuration.copy()
    for i in rng.choice(len(other), switches, replace=False):
        states = [j for j in range(arm.states[i]) if j != other[i]]
        cheapest = [int((arm.bits[i, j] != arm.bits[i, other[i]]).sum()) for j in states]
        other[i] = states[int(np.argmin(cheapest))]
    return other


@pytest.mark.parametrize("kind", LONG)
def test_a_long_arm_finds_and_proves_a_few_switches(kind):
    arm, rng = LONG[kind], np.random.default_rng(11)
    solver = solver_of(arm)
    leaps = leaps_of(solver)
    assert leaps.worthwhile
    for _ in range(4):
        start = rng.integers(0, arm.states)
        goal = changed(arm, start, 3, rng)
        target = solver.target(arm.tip(goal)[: arm.dimension, 3], 1e-6)
        problem = Problem(target, start, switch_costs(arm, start, solver.weights))
        incumbent = Incumbent(start, np.inf)
        leaps.prove(problem, incumbent)
        if problem.cost(goal) <= 4:
            assert incumbent.proven
            assert incumbent.cost <= problem.cost(goal)


@pytest.mark.parametrize("weighted", [False, True])
def test_a_long_arm_finds_what_six_switches_reach(weighted):
    arm, rng = spatial_arm(48), np.random.default_rng(4)
    weights = rng.uniform(0.5, 3, len(arm.actuators)) if weighted else np.ones(len(arm.actuators))
    solver = solver_of(arm, weights)
    for _ in range(3):
        start = rng.integers(0, arm.states)
        while arm.switches(start, known := changed(arm, start, int(rng.integers(3, 7)), rng)) not in (5, 6):
            pass
        goal = solver.target(arm.tip(known)[:3, 3], 2e-5 * arm.length)
        found = solver.solve(goal, start, timeout=search_effort(200.0))
        assert found.within_tolerance
        assert found.cost <= solver.cost(known, start) + 1e-9
        assert weighted or found.certificate == "optimal"


def test_leaps_save_a_long_arm_switches_in_the_same_work(monkeypatch):
    arm, rng = LONG["planar"], np.random.default_rng(3)
    pairs = [(rng.integers(0, arm.states), arm.tip(rng.integers(0, arm.states))[:2, 3]) for _ in range(8)]

    def solved() -> float:
        solver = solver_of(arm)
        found = [solver.solve(solver.target(goal, 0.01), start, timeout=search_effort(150.0)) for start, goal in pairs]
        assert all(each.within_tolerance and each.bound <= each.cost for each in found)
        return sum(each.cost for each in found)

    cost = solved()
    before = Leaps.__init__

    def short(self: Leaps, *arguments: object) -> None:
        before(self, *arguments)
        self.worthwhile = False

    monkeypatch.setattr(Leaps, "__init__", short)
    assert cost < solved()


def test_obstacles_and_short_arms_are_heeded():
    assert not leaps_of(solver_of(paper_arm(16))).worthwhile
    assert not leaps_of(solver_of(paper_arm(1))).worthwhile
    arm, rng = LONG["planar"], np.random.default_rng(5)
    start = np.zeros(48, dtype=np.int64)
    free = solver_of(arm)
    goal = arm.tip(changed(arm, start, 2, rng))[:2, 3]
    found = free.solve(free.target(goal, 1e-3), start)
    clearance = BodyClearance(arm, obstacles_of([Disc(tuple(arm.chain(found.configuration)[24][:2, 3]), 0.05)]))
    among = solver_of(arm, None, clearance)
    target = among.target(goal, 1e-3)
    incumbent = Incumbent(start, np.inf)
    problem = Problem(target, start, switch_costs(arm, start, among.weights))
    leaps_of(among).prove(problem, incumbent)
    assert incumbent.cost > found.cost
    assert incumbent.cost == np.inf or not collides(target.scene, incumbent.configuration)
