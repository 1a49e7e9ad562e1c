"""Searches among obstacles against brute force, on arms with few configurations."""

from __future__ import annotations

import re
from functools import cache
from typing import NamedTuple

import numpy as np
import pytest

from hyperbit.controller.manipulator.frame_kernels import angle_between
from hyperbit.controller.manipulator.frames import turned
from hyperbit.controller.manipulator.manipulator import Manipulator
from hyperbit.controller.obstacles.clearance import BodyClearance
from hyperbit.controller.obstacles.obstacles import NONE
from hyperbit.controller.search.method import METHODS
from hyperbit.controller.search.obstructed import obstructed
from tests.arms import every_configuration, paper_arm, spatial_arm
from tests.obstacles.dense import Box, Disc, HalfPlane, Shape, nearest, obstacles_of
from tests.search.worlds import solver_of

SURE = 1e-7  # what is nearer to a tolerance or an obstacle than this may count as within or not


def scene(arm: Manipulator, rng: np.random.Generator) -> list[Shape]:
    """Obstacles among what the arm reaches; if possible they leave some of its configurations clear."""
    some = rng.integers(0, arm.states, (100, len(arm.states)))
    for _ in range(20):
        parts = any_scene(arm, rng)
        if 0.2 < BodyClearance(arm, obstacles_of(parts)).blocked(some).mean() < 0.8:
            break
    return parts


def any_scene(arm: Manipulator, rng: np.random.Generator) -> list[Shape]:
    size, found = arm.dimension, list[Shape]()
    for _ in range(rng.integers(1, 4)):
        tip = arm.tip(rng.integers(0, arm.states))[:3, 3]
        centre = arm.base[:3, 3] + (tip - arm.base[:3, 3]) * rng.uniform(0.2, 1.2) + rng.normal(0, 0.1, 3)
        kind = rng.integers(3)
        if kind == 0:
            found.append(Disc(tuple(centre[:size]), arm.length * rng.uniform(0.02, 0.15)))
        elif kind == 1:
            frame = turned((0, 0, 1) if arm.planar else rng.normal(size=3), rng.uniform(-3, 3))
            frame[:3, 3] = centre * (1, 1, not arm.planar)
            found.append(Box(frame, tuple(arm.length * rng.uniform(0.02, 0.3, size))))
        else:
            away = arm.base[:3, 3] - centre + rng.normal(0, 0.1, 3)
            found.append(HalfPlane(tuple(centre[:size]), tuple(away[:size])))
    return found


def clearances(arm: Manipulator, parts: list[Shape], radius: float, touch: bool) -> list[BodyClearance]:
    """The clearance as given, slightly smaller, and slightly larger."""
    return [
        BodyClearance(arm, obstacles_of(parts), max(radius + s, 0), self_collision=touch) for s in (0.0, -SURE, SURE)
    ]


def check_clear(arm: Manipulator, configuration: np.ndarray, parts: list[Shape], radius: float) -> None:
    assert nearest(arm.body(configuration), parts) > radius - 1e-9


class Scenario(NamedTuple):
    """Obstacles, with goals among them.

    Attributes:
        turn: tolerance of the angle [rad]; infinite without orientation.
        previous: first configuration (B,).
        goals: frames (n, 4, 4) of the goals.
        solutions: for each goal, the configurations (m, B) that surely reach it and are clear.
    """

    parts: list[Shape]
    clearance: BodyClearance
    turn: float
    previous: np.ndarray
    goals: np.ndarray
    solutions: list[np.ndarray]


ARMS = {"planar": paper_arm(5), "spatial": spatial_arm(5)}


@cache
def scenarios(kind: str, tolerance: float) -> list[Scenario]:
    """Returns scenes with the solutions of their goals by brute force, which are the same for each method."""
    arm = ARMS[kind]
    every, rng = every_configuration(arm), np.random.default_rng(len(arm.modules))
    tips, found = arm.tips(every)[:, :3, 3], list[Scenario]()
    for turn in (np.inf, 0.1) * 6:
        parts = scene(arm, rng)
        exact, _, strict = clearances(arm, parts, 0.01, touch=turn == np.inf)
        previous, solutions = rng.integers(0, arm.states), list[np.ndarray]()
        goals = arm.tips(rng.integers(0, arm.states, (5, len(arm.states))))
        for goal in goals:
            near = every[np.linalg.norm(tips - goal[:3, 3], axis=1) <= tolerance - SURE]
            near = near[[turn == np.inf or angle_between(tip, goal) <= turn - SURE for tip in arm.tips(near)]]
            solutions.append(near[~strict.blocked(near)])
        found.append(Scenario(parts, exact, turn, previous, goals, solutions))
    return found


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("kind", ARMS)
def test_every_method_reaches_what_can_be_reached(kind, method):
    arm, tolerance = ARMS[kind], 0.01
    solver, found, solvable = solver_of(arm), 0, 0
    for parts, clearance, turn, first, goals, solutions in scenarios(kind, tolerance):
        solver, previous = solver.avoiding(clearance), first
        for goal, there in zip(goals, solutions, strict=True):
            asked = goal if turn < np.inf else goal[: arm.dimension, 3]
            solution = solver.solve(solver.target(asked, tolerance, turn), previous, method, timeout=1.0)
            solvable += len(there) > 0
            found += solution.within_tolerance and len(there) > 0
            if solution.optimal and len(there):
                assert solution.switches <= min(arm.switches(c, previous) for c in there)
            if solution.within_tolerance:
                check_clear(arm, solution.configuration, parts, 0.01)
                previous = solution.configuration
    assert solvable > 20
    assert found == solvable


@pytest.mark.parametrize("among", [False, True])
@pytest.mark.parametrize("arm", ARMS.values(), ids=ARMS)
def test_candidates_are_the_cheapest_within_both_tolerances_that_are_clear(arm, among):
    every, tolerance, rng = every_configuration(arm), 0.02, np.random.default_rng(8)
    tips, plain, found = arm.tips(every), solver_of(arm), 0
    for _ in range(10):
        exact, _, strict = clearances(arm, parts := scene(arm, rng) if among else [], 0.01, touch=among)
        previous, goal = rng.integers(0, arm.states), arm.tip(rng.integers(0, arm.states))
        avoiding = plain.avoiding(exact)
        configurations, costs, _ = avoiding.candidates(avoiding.target(goal, tolerance, 0.5), previous, 8)
        for configuration, cost in zip(configurations, costs, strict=True):
            if among:
                check_clear(arm, configuration, parts, 0.01)
            assert cost == arm.switches(configuration, previous)
        near = every[np.linalg.norm(tips[:, :3, 3] - goal[:3, 3], axis=1) <= tolerance - SURE]
        near = near[[angle_between(tip, goal) <= 0.5 - SURE for tip in arm.tips(near)]]
        clear = near[~strict.blocked(near)]
        assert len(costs) >= min(len(clear), 8)
        fewest = np.sort([arm.switches(c, previous) for c in clear])[: len(costs)]
        assert np.all(np.sort(costs)[: len(fewest)] <= fewest)
        found += len(costs)
    assert found > 20


def test_what_was_noted_of_other_regions_is_forgotten():
    """The same memory and previous configuration: only the obstacles change, and change back."""
    arm, previous = paper_arm(6), np.zeros(6, dtype=np.int64)
    plain, goal = solver_of(arm), arm.tip([0, 3, 0, 5, 0, 0])[:2, 3]
    there = plain.solve(plain.target(goal, 0.01), previous)
    middle = arm.body(there.configuration)[:, :, :2].reshape(-1, 2)[12]
    among = plain.avoiding(BodyClearance(arm, obstacles_of([Disc(tuple(middle), 0.02)])))
    around = among.solve(among.target(goal, 0.01), previous)
    assert around.optimal
    assert around.switches > there.switches
    assert np.array_equal(plain.solve(plain.target(goal, 0.01), previous).configuration, there.configuration)
    assert np.array_equal(among.solve(among.target(goal, 0.01), previous).configuration, around.configuration)
    elsewhere = plain.avoiding(BodyClearance(arm, obstacles_of([Disc((2.0, 0.0), 0.02)])))
    assert np.array_equal(elsewhere.solve(elsewhere.target(goal, 0.01), previous).configuration, there.configuration)


@pytest.mark.parametrize("method", METHODS)
def test_a_goal_in_a_region_is_told_to_be_out_of_reach_and_not_approached_through_it(method):
    arm, previous = paper_arm(6), np.zeros(6, dtype=np.int64)
    tip = arm.tip(previous)[:2, 3]
    parts: list[Shape] = [Disc(tuple(tip), 0.1)]  # around where the arm stands
    solver = solver_of(arm, None, BodyClearance(arm, obstacles_of(parts), 0.01))
    found = solver.solve(solver.target(tip, 0.01), previous, method)
    assert not found.within_tolerance
    assert not found.optimal
    check_clear(arm, found.configuration, parts, 0.01)
    assert 0.1 < found.error < 0.2
    if method == "minimum-switch":
        assert found.lower_bound == np.inf


def test_nothing_to_avoid_is_as_no_clearance_at_all():
    arm = paper_arm(4)
    assert solver_of(arm, None, BodyClearance(arm, NONE)).scene is None


@pytest.mark.parametrize("method", ["minimum-switch", "ipop-previous"])
def test_a_missed_goal_names_what_is_in_the_way(method):
    arm = paper_arm(4)
    rest, far = np.zeros(4, dtype=np.int64), arm.states - 1
    tip = arm.tip(far)[:2, 3]
    crate, wall = Disc(tuple(tip), 0.3), HalfPlane(tuple(0.6 * tip), tuple(-tip))
    for parts, point, told in (
        ([crate], tip, r"is in .*disc.*"),
        ([wall], tip, r"is in .*half-plane.*"),
        (
            [Disc(tuple(0.6 * tip), 0.1)],
            tip,
            r"(is|seems) out of reach without a collision, such as: module \d is in .*disc.*",
        ),
        ([Disc((9, 9), 0.1)], 3 * tip, "(is|seems) out of reach"),
    ):
        solver = solver_of(arm, clearance=BodyClearance(arm, obstacles_of(parts)))
        target = solver.target(point, 0.01)
        missed = solver.solve(target, rest, method)
        explained = solver.explained(missed, target, rest)
        assert re.fullmatch(told, explained.reach), explained.reach
        assert not explained.within_tolerance


def test_positions_that_obstacles_take_away_are_those_of_brute_force():
    arm, radius = paper_arm(4), 0.02
    every = every_configuration(arm)
    tips, away = arm.tips(every)[:, :2, 3], arm.tip(arm.states - 1)[:2, 3]
    clearance = BodyClearance(arm, obstacles_of([Disc(tuple(0.7 * away), 0.1)]))
    clear = ~clearance.blocked(every)
    lost = obstructed(solver_of(arm, clearance=clearance), radius, count=60)
    near = np.linalg.norm(tips[None] - lost.positions[:, None], axis=2)
    assert (near.min(axis=1) <= radius + SURE).all()
    assert (lost.reached == (near[:, clear].min(axis=1) <= radius)).all()
    assert (~lost.reached).sum() == sum(lost.inside.values()) + sum(lost.behind.values()) > 0
    assert {*lost.inside, *lost.behind} <= {*clearance.obstacles.names}
