"""Searches that end by work: the answer is a function of arm, goal, start and effort alone."""

import multiprocessing
from typing import Any, NamedTuple

import numpy as np
import pytest

from hyperbit.controller.manipulator.manipulator import Manipulator
from hyperbit.controller.obstacles.clearance import BodyClearance
from hyperbit.controller.search.clock import WorkClock
from hyperbit.controller.search.method import MINIMUM_SWITCH, Method
from hyperbit.controller.search.search_time import search_effort
from hyperbit.controller.search.solver import Solver
from hyperbit.controller.workspace.mapping import map_densities
from tests.arms import paper_arm, spatial_arm
from tests.obstacles.dense import Disc, obstacles_of

Answer = tuple[Any, ...]


class Asked(NamedTuple):
    """A search: goal (a position or a frame), start, tolerances, effort and method."""

    goal: np.ndarray
    start: np.ndarray
    tolerance: float
    angle: float
    effort: float
    method: Method = MINIMUM_SWITCH


def arm_of(kind: str) -> Manipulator:
    return spatial_arm(6) if kind == "spatial" else paper_arm(48 if kind == "long" else 16)


def solver_of(kind: str) -> Solver:
    arm = arm_of(kind)
    clearance = BodyClearance(arm, obstacles_of([Disc((1.2, 2.0), 0.3)])) if kind == "obstacle" else None
    return Solver(arm, map_densities(arm, arm.length / 60, 4000), None, clearance)


def searches(kind: str) -> list[Asked]:
    """Goals near and far, positions and poses, some from one start and some from others, with little and much work."""
    arm, rng = arm_of(kind), np.random.default_rng(7)
    starts = [np.zeros(len(arm.modules), dtype=np.int64), rng.integers(0, arm.states)]
    asked = list[Asked]()
    for k in range(12):
        tip = arm.tip(rng.integers(0, arm.states))
        goal = tip if k % 4 == 3 else tip[: arm.dimension, 3] * (1.2 if k % 6 == 5 else 1.0)
        angle = 0.05 if k % 4 == 3 else np.inf
        effort = (2.0, 15.0, 60.0)[k % 3]
        method: Method = "ipop-fewest-switches" if k == 8 else MINIMUM_SWITCH
        asked.append(Asked(goal, starts[k // 2 % 2], 0.002 if k % 2 else 0.004, angle, effort, method))
    return asked


def answer(solver: Solver, asked: Asked) -> Answer:
    target = solver.target(asked.goal, asked.tolerance, asked.angle)
    found = solver.solve(target, asked.start, asked.method, search_effort(asked.effort))
    return (*found.configuration.tolist(), found.cost, found.bound, found.certificate, found.error, found.effort)


def answers(kind: str, order: list[int]) -> dict[int, Answer]:
    solver, asked = solver_of(kind), searches(kind)
    solver.prepare()
    return {k: answer(solver, asked[k]) for k in order}


@pytest.mark.parametrize("kind", ["paper", "obstacle", "spatial", "long"])
def test_an_answer_by_work_does_not_depend_on_earlier_searches(kind):
    """Alone, on a solver of its own; in order and in reverse, after others; after searches that ended by time."""
    asked = searches(kind)
    solver = solver_of(kind)
    alone = {k: answer(solver.another(), one) for k, one in enumerate(asked)}
    for order in (range(len(asked)), reversed(range(len(asked)))):
        assert answers(kind, list(order)) == alone
    for one in asked[:4]:
        solver.solve(solver.target(one.goal, one.tolerance, one.angle), one.start)
        for _ in solver.expect(one.start, one.tolerance):
            pass
    assert {k: answer(solver, one) for k, one in enumerate(asked)} == alone


def test_two_processes_give_the_answers_of_one():
    order = [1, 4, 7, 10]
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        other = pool.apply(answers, ("paper", order))
    assert other == answers("paper", order[::-1])


def test_more_effort_proves_more_and_is_spent(monkeypatch):
    """Little work leaves a gap, much work closes it, and a clock that stands still never ends the search."""
    solver = solver_of("paper")
    start, tip = np.full(16, 7), solver.manipulator.tip(np.zeros(16, dtype=np.int64))
    little, much = (
        solver.solve(solver.target(tip[:2, 3], 2e-3), start, timeout=search_effort(effort)) for effort in (1.0, 3000.0)
    )
    assert little.effort < much.effort
    assert little.bound <= much.bound <= much.cost <= little.cost
    assert much.optimal
    assert not little.optimal
    monkeypatch.setattr(WorkClock, "now", lambda self: 0.0)
    assert solver.solve(solver.target(tip[:2, 3], 2e-3), start, timeout=search_effort(1.0)).optimal
