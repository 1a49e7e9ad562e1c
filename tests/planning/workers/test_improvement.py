"""Improvements of a running plan."""

import math
from typing import Any

import pytest

from hyperbit.controller.motion.stages.feed import Improved, PlannedPoint
from hyperbit.controller.planning.core.tasks import Deviations, ImprovePlan, Planned
from hyperbit.controller.planning.workers import computations
from hyperbit.controller.planning.workers.computations import Abandoned, improve, plan_goal
from tests.planning.workers.conftest import A, B, Bench, C, abandoned, nothing

PATH = [A, B, C, A, (2, 2, 1, 0), (5, 1, 4, 0), B, C]


@pytest.fixture
def hasty(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> Planned:
    monkeypatch.setattr(computations, "PLANNING_TIME", 0.0)
    message = bench.goal(*(bench.tip(*c) for c in PATH), tolerance={"position": 0.05})
    return plan_goal(bench.model, bench.task(A, message=message), nothing)


def task(bench: Bench, planned: Planned, **changes: Any) -> ImprovePlan:
    return ImprovePlan(planned.plan, math.inf, True, bench.tables, bench.free)._replace(**changes)


def improvements(bench: Bench, wanted: ImprovePlan) -> list[Improved]:
    deviations, *improved = improve(bench.model, wanted, nothing)
    assert isinstance(deviations, Deviations)
    return [answer for answer in improved if isinstance(answer, Improved)]


def test_deviations_come_first(bench: Bench, hasty: Planned) -> None:
    (deviations,) = improve(bench.model, task(bench, hasty, search=False), nothing)
    assert isinstance(deviations, Deviations)
    assert len(deviations.values) == len(PATH)


def test_an_improvement_has_all_points_from_the_first_changed_one(bench: Bench, hasty: Planned) -> None:
    points, costs = list[PlannedPoint](hasty.points), [hasty.proof.cost]
    improved = improvements(bench, task(bench, hasty))
    assert improved
    for answer in improved:
        assert answer.first >= 1
        assert [point.point for point in answer.points] == list(range(answer.first, len(PATH)))
        assert answer.points[0].stages != points[answer.first].stages
        points[answer.first :] = answer.points
        costs.append(answer.proof.cost)
        stages = [stage for point in points for stage in point.stages]
        assert answer.proof.switches == sum(point.switches for point in points) == bench.switches(bytes(2), stages)
        assert all(point.deviation is not None for point in answer.points[:1])
    assert costs[-1] < costs[0]


def test_improvements_start_from_commanded_states_too(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(computations, "PLANNING_TIME", 0.0)
    message = bench.goal(*(bench.tip(*c) for c in PATH), tolerance={"position": 0.05})
    start = bench.start(commanded=bench.packed(1, 0, 0, 0))
    planned = plan_goal(bench.model, bench.task(A, message=message, start=start), nothing)
    deviations, *improved = improve(bench.model, task(bench, planned), nothing)
    assert isinstance(deviations, Deviations)
    assert improved
    assert all(isinstance(answer, Improved) and answer.first >= 1 for answer in improved)


def test_improvements_that_would_collide_are_not_told(
    bench: Bench, hasty: Planned, monkeypatch: pytest.MonkeyPatch
) -> None:
    scene = bench.scene(([5.0, 5.0], 0.1))
    assert improvements(bench, task(bench, hasty, scene=scene))
    monkeypatch.setattr(type(scene.keep_out), "first_collision", lambda *_: "it collides")
    assert not improvements(bench, task(bench, hasty, scene=scene))


def test_a_plan_for_other_locked_actuators_is_not_improved(bench: Bench, hasty: Planned) -> None:
    assert not improvements(bench, task(bench, hasty, tables=bench.tables._replace(generation=2)))


def test_an_abandoned_improvement_ends(bench: Bench, hasty: Planned) -> None:
    with pytest.raises(Abandoned):
        next(improve(bench.model, task(bench, hasty), abandoned))
    answers = list[Any]()

    def proceed() -> None:
        if answers:
            raise Abandoned

    answering = improve(bench.model, task(bench, hasty), proceed)
    answers.append(next(answering))
    with pytest.raises(Abandoned):
        next(answering)
