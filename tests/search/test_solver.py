"""The methods of section 3.2 on the arm of section 4 and on arms of other types."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hyperbit.controller.manipulator import frames
from hyperbit.controller.manipulator.manipulator import Manipulator
from hyperbit.controller.manipulator.module import transforms
from hyperbit.controller.search.method import METHODS
from hyperbit.controller.search.solver import Solver
from hyperbit.controller.workspace.mapping import map_densities
from tests.arms import (
    any_frames,
    every_configuration,
    listed,
    paper_arm,
    planar_frames,
    planar_modules,
    short_arms,
    spatial_arm,
    spatial_frames,
)

TARGETS = [(3.0, 0.7), (0.55, 2.9), (0.4, 2.9)]
TOLERANCE = 0.002
IPOP_AND_POP = METHODS[1:]
each_method = pytest.mark.parametrize("method", IPOP_AND_POP)


def solver_of(manipulator: Manipulator, pixel: float = 0.02) -> Solver:
    return Solver(manipulator, map_densities(manipulator, pixel, 1 << 17), list_whole=False)


def random_goals(manipulator: Manipulator, count: int, seed: int = 0) -> np.ndarray:
    """Tips (count, dimension) of configurations drawn at random."""
    configurations = np.random.default_rng(seed).integers(0, manipulator.states, (count, len(manipulator.modules)))
    return manipulator.tips(configurations)[:, : manipulator.dimension, 3]


@each_method
def test_the_experiment_of_figure_5(solver, method):
    previous = np.zeros(16, dtype=np.int64)
    for target in TARGETS:
        solution = solver.solve(solver.target(target, TOLERANCE), previous, method)
        assert solution.error <= 0.003
        assert solution.error == pytest.approx(np.linalg.norm(solution.tip[:2, 3] - target))
        assert np.allclose(solution.tip, solver.manipulator.tip(solution.configuration))
        assert solution.switches == solver.manipulator.switches(previous, solution.configuration)
        assert solution.within_tolerance == (solution.error <= TOLERANCE)
        previous = solution.configuration


def followed(solver, method, goals):
    """Solutions for goals, each from the configuration reached for the goal before."""
    previous, solutions = np.zeros(len(solver.manipulator.modules), dtype=np.int64), []
    for goal in goals:
        solutions.append(solver.solve(solver.target(goal, TOLERANCE), previous, method))
        previous = solutions[-1].configuration
    return solutions


def test_a_hundred_goals_are_reached_and_history_saves_switches(solver):
    goals = random_goals(solver.manipulator, 100)
    switches = {}
    for method in IPOP_AND_POP:
        solutions = followed(solver, method, goals)
        assert all(s.within_tolerance for s in solutions)
        switches[method] = np.mean([s.switches for s in solutions])
    assert switches["ipop-fewest-switches"] < 0.6 * switches["pop"]
    assert switches["ipop-fewest-switches"] < switches["ipop-previous"] < 0.8 * switches["pop"]


def test_a_configuration_that_is_good_already_is_kept(solver):
    edge = [[7] * 16, [1] * 16, [4] * 16, [5, 2] * 8]  # few come there, so that no density would lead back to them
    for previous in [*np.array(edge), *np.random.default_rng(3).integers(0, 8, (30, 16))]:
        here = solver.manipulator.tip(previous)[:2, 3]
        solution = solver.solve(solver.target(here + np.array([0.0019, 0]), TOLERANCE), previous)
        assert solution.configuration.tolist() == previous.tolist()
        assert solution.switches == 0


def test_a_configuration_just_not_good_enough_is_left(solver):
    previous = np.random.default_rng(3).integers(0, 8, 16)
    goal = solver.manipulator.tip(previous)[:2, 3] + np.array([0.0021, 0])
    solution = solver.solve(solver.target(goal, TOLERANCE), previous)
    assert solution.within_tolerance
    assert solution.switches > 0


@given(st.lists(st.integers(0, 7), min_size=16, max_size=16))
@pytest.mark.parametrize("method", ["ipop-contracted", "ipop-fewest-extended", "pop"])
def test_without_history_the_previous_configuration_plays_no_part(solver, method, previous):
    for target in TARGETS:
        from_rest = solver.solve(solver.target(target, TOLERANCE), np.zeros(16, dtype=np.int64), method).configuration
        assert (
            solver.solve(solver.target(target, TOLERANCE), np.array(previous), method).configuration.tolist()
            == from_rest.tolist()
        )


def test_contraction_extends_fewer_actuators(solver):
    goals = random_goals(solver.manipulator, 50)
    extended = {
        method: np.mean(
            [solver.manipulator.actuator_states(s.configuration).sum() for s in followed(solver, method, goals)]
        )
        for method in IPOP_AND_POP
    }
    assert extended["ipop-contracted"] < extended["pop"]
    assert extended["ipop-fewest-extended"] < extended["ipop-previous"]
    assert extended["ipop-fewest-extended"] < extended["pop"]


@each_method
@settings(max_examples=6)
@given(base=planar_frames)
def test_the_arm_carried_elsewhere_does_the_same_there(solver, densities, method, base):
    moved = Solver(Manipulator(solver.manipulator.modules, base), densities)
    same = 0
    for target in random_goals(solver.manipulator, 5):
        there = (base @ [*target, 0, 1])[:2]
        previous = np.zeros(16, dtype=np.int64)
        here, carried = (
            s.solve(s.target(g, TOLERANCE), previous, method) for s, g in ((solver, target), (moved, there))
        )
        if carried.configuration.tolist() == here.configuration.tolist():
            same += 1
            assert carried.error == pytest.approx(here.error, abs=1e-9)
    assert same >= 4, "rounding decides at the edge of a pixel, which few searches meet"


@settings(max_examples=20)
@given(any_frames)
def test_a_planar_arm_on_a_tilted_base_takes_goals_in_space(base):
    solver = solver_of(Manipulator(paper_arm(4).modules, base))
    goal = solver.manipulator.tip([3, 1, 4, 1])[: solver.manipulator.dimension, 3]
    assert solver.solve(solver.target(goal, TOLERANCE), np.zeros(4, dtype=np.int64)).within_tolerance


@each_method
@settings(max_examples=20)
@given(
    manipulator=short_arms(planar_modules) | short_arms(listed(spatial_frames, planar=False)), seed=st.integers(0, 1000)
)
def test_short_arms_are_brought_as_near_as_any_configuration_brings_them(method, manipulator, seed):
    solver = solver_of(manipulator, 0.1)
    goal = np.random.default_rng(seed).uniform(-1, 1, manipulator.dimension)
    low, high = (corner[: manipulator.dimension] for corner in solver.densities.box(0))
    goal = np.clip(goal, low, high)  # what is farther away is taken to the nearest pixel first
    solution = solver.solve(solver.target(goal, 1e-9), np.zeros(len(manipulator.modules), dtype=np.int64), method)
    tips = manipulator.tips(every_configuration(manipulator))[:, : manipulator.dimension, 3]
    assert solution.error == pytest.approx(np.linalg.norm(tips - goal, axis=1).min(), abs=1e-9)


def stack(count: int, *modules) -> Manipulator:
    return Manipulator(modules * count)


BEND = [frames.planar(0.05, 0.2, -0.4), frames.planar(0, 0.2), frames.planar(-0.05, 0.2, 0.4)]
ARMS = {
    "one module": paper_arm(1),
    "two modules": paper_arm(2),
    "two states each": stack(20, transforms(BEND[::2], planar=True)),
    "three states each": stack(14, transforms(BEND, planar=True)),
    "unlike modules": stack(4, *paper_arm(2).modules, transforms(BEND, planar=True)),
    "one large module": Manipulator([transforms([frames.planar(x / 300, 1) for x in range(300)], planar=True)] * 2),
    "spatial": spatial_arm(10),
    "fifty modules": paper_arm(50),
}


@each_method
@pytest.mark.parametrize("manipulator", ARMS.values(), ids=ARMS)
def test_every_kind_of_arm_reaches_where_it_can(manipulator, method):
    solver = solver_of(manipulator, 0.05)
    step = np.linalg.norm(manipulator.translations, axis=2).max()
    errors = [s.error for s in followed(solver, method, random_goals(manipulator, 20))]
    assert max(errors) <= (0.1 if manipulator.dimension == 3 else 0.05) * step * np.sqrt(len(manipulator.modules))
    assert np.median(errors) <= TOLERANCE * (5 if manipulator.dimension == 3 else 1)


@each_method
@pytest.mark.parametrize("distance", [6.0, 1e6])
@pytest.mark.parametrize("direction", np.linspace(0, 2 * np.pi, 8, endpoint=False).round(3))
def test_a_goal_out_of_reach_is_approached_as_far_as_the_arm_goes(solver, densities, method, distance, direction):
    goal = distance * np.array([np.cos(direction), np.sin(direction)])
    solution = solver.solve(solver.target(goal, TOLERANCE), np.zeros(16, dtype=np.int64), method)
    y, x = np.nonzero(densities.level(0)[0] >= 0)
    reachable = densities.references[0][:2] + densities.pixels[0] * np.column_stack((x, y))
    nearest = np.linalg.norm(reachable - goal, axis=1).min()
    assert not solution.within_tolerance
    assert solution.error - nearest <= 0.06


def test_a_spatial_arm_approaches_what_is_out_of_reach():
    solver = solver_of(spatial_arm(8), 0.05)
    solution = solver.solve(solver.target((0, 0, 50), TOLERANCE), np.zeros(8, dtype=np.int64))
    assert solution.tip[2, 3] > 1.95  # of 2.0, all extended


def test_another_solver_shares_the_tables_and_searches_at_the_same_time(solver):
    other, previous = solver.another(), np.zeros(16, dtype=np.int64)
    assert other.densities is solver.densities
    assert other.paths is solver.paths
    assert other.minimum is not solver.minimum
    for target in TARGETS:
        alone, beside = (one.solve(one.target(target, TOLERANCE), previous) for one in (solver, other))
        assert alone.within_tolerance == beside.within_tolerance
