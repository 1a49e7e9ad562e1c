"""Plans of goals, their improvements and descriptions, as functions of their tasks."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from hyperbit.controller.motion.stages.feed import Improved, PlannedPoint
from hyperbit.controller.planning.core.tasks import DescribePlan, Deviations, Done, ImprovePlan, Planned, PrepareSearch
from hyperbit.controller.planning.workers import computations
from hyperbit.controller.planning.workers.computations import (
    Abandoned,
    ArmModel,
    describe,
    improve,
    plan_goal,
    prepare_search,
)
from hyperbit.controller.refusals import codes
from hyperbit.controller.refusals.refusal import Refusal
from tests.planning.conftest import DOCUMENT, JOINT, unused_states
from tests.planning.workers.conftest import HOME, A, B, Bench, C, abandoned, nothing

Make = Callable[[dict[str, Any]], Bench]


def stages(planned: Planned) -> list[bytes]:
    return [stage for point in planned.points for stage in point.stages]


def refusal(bench: Bench, **changes: Any) -> Refusal:
    with pytest.raises(Refusal) as refused:
        plan_goal(bench.model, bench.task(A, **changes), nothing)
    return refused.value


def test_each_point_of_a_plan_reaches_its_position(bench: Bench) -> None:
    planned = plan_goal(bench.model, bench.task(A, B, C), nothing)
    assert [point.point for point in planned.points] == [0, 1, 2]
    for point, configuration in zip(planned.points, (A, B, C), strict=True):
        away = bench.tip_of(point.stages[-1]) - bench.tip(*configuration)
        assert np.linalg.norm(away) <= bench.arm.tolerance + 1e-9
    assert sum(point.switches for point in planned.points) == bench.switches(bytes(2), stages(planned))


def test_a_proof_counts_all_switches_and_bounds_them(bench: Bench) -> None:
    planned = plan_goal(bench.model, bench.task(A), nothing)
    assert planned.proof.switches == planned.points[0].switches == bench.switches(bytes(2), stages(planned))
    assert 0 <= planned.proof.bound <= planned.proof.cost == pytest.approx(planned.proof.switches)
    assert planned.proof.certificate in ("optimal", "bound", "unknown")


def test_stages_start_from_commanded_states_and_the_proof_from_measured_ones(bench: Bench) -> None:
    start = bench.start(bench.packed(*HOME), commanded=bench.packed(*C))
    planned = plan_goal(bench.model, bench.task(A, B, start=start), nothing)
    assert np.linalg.norm(bench.tip_of(planned.points[0].stages[-1]) - bench.tip(*A)) <= bench.arm.tolerance + 1e-9
    assert planned.points[0].switches == bench.switches(bench.packed(*C), list(planned.points[0].stages))
    assert planned.proof.switches == bench.switches(bench.packed(*HOME), [p.stages[-1] for p in planned.points])
    assert planned.proof.switches != sum(point.switches for point in planned.points)


def test_stages_from_commanded_states_keep_the_inrush_bound(make_bench: Make) -> None:
    bench = make_bench({**DOCUMENT, "inrush": 2})
    start = bench.start(bench.packed(*HOME), commanded=bench.packed(*C))
    planned = plan_goal(bench.model, bench.task(A, B, start=start), nothing)
    before = start.commanded
    for stage in stages(planned):
        assert bench.switches(before, [stage]) <= 2
        before = stage


def test_stages_from_commanded_states_that_collide_are_refused(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    scene = bench.scene(([5.0, 5.0], 0.1))
    commanded = bench.states(bench.packed(*C))
    monkeypatch.setattr(
        type(scene.keep_out),
        "first_collision",
        lambda self, states, *_: "module 1 is in it" if np.array_equal(states, commanded) else None,
    )
    start = bench.start(bench.packed(*HOME), commanded=bench.packed(*C))
    words = "the motion from the arm's present state would collide: module 1 is in it"
    refused = refusal(bench, start=start, scene=scene)
    assert (refused.code, str(refused)) == (codes.INVALID_GOAL, words)


def test_a_plan_among_obstacles_is_clear(bench: Bench) -> None:
    scene = bench.scene((bench.tip(*B), 0.02))
    planned = plan_goal(bench.model, bench.task(A, scene=scene), nothing)
    rows = [bench.states(stage) for stage in stages(planned)]
    assert scene.keep_out.first_collision(bench.states(bytes(2)), rows) is None
    refused = refusal(bench, scene=bench.scene((bench.tip(*HOME), 0.02)))
    assert str(refused).startswith("the arm may not move from where it stands")


def test_a_plan_is_abandoned_in_its_check_of_all_stages(bench: Bench) -> None:
    task, calls = bench.task(A, B, C, scene=bench.scene(([5.0, 5.0], 0.1))), list[int]()

    def proceed() -> None:
        calls.append(0)
        if len(calls) == 4 + 1:  # one call for each of three points, one for the first stage
            raise Abandoned

    with pytest.raises(Abandoned):
        plan_goal(bench.model, task, proceed)


def test_bits_of_locked_actuators_are_those_of_the_outputs(small: Any, small_densities: Any) -> None:
    bench = Bench(small, small_densities, bytes([0] + [255] * 11))
    start = bench.start(locked=b"\1\0")._replace(outputs=b"\1\0")  # its output is on, and it stands contracted
    planned = plan_goal(bench.model, bench.task((0, 1, 0, 0), start=start), nothing)
    assert all(stage[0] & 1 for stage in stages(planned))
    assert planned.points[0].switches == planned.proof.switches


def test_states_that_are_no_configuration_are_refused(make_bench: Make) -> None:
    bench = make_bench({**DOCUMENT, "modules": [JOINT]})
    states = bytes([unused_states(bench.arm)])
    with pytest.raises(Refusal, match=r"^unknown state: what the boards measure is no configuration: .*`jog`$"):
        plan_goal(bench.model, bench.task((0, 0), start=bench.start(states)), nothing)


def test_states_that_the_reduced_arm_has_not_are_refused(small: Any, small_densities: Any) -> None:
    bench = Bench(small, small_densities, bytes([0] + [255] * 11))
    assert "the locked actuators are changing" in str(refusal(bench, start=bench.start(b"\1\0")))


def test_a_goal_is_corrected_by_the_tip_bias(bench: Bench) -> None:
    message = bench.goal(bench.tip(*A), tolerance={"position": 0.05})
    planned = plan_goal(bench.model, bench.task(A, message=message, bias=(0.01, 0.0)), nothing)
    assert np.allclose(planned.trajectory.positions[0], np.array(bench.tip(*A)) - [0.01, 0.0])


def test_a_plan_that_no_program_holds_is_refused(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(computations, "MOST_PROGRAM_STAGES", 1)
    with pytest.raises(Refusal, match="the plan has 2 stages, 1 to one point; at most 1 and"):
        plan_goal(bench.model, bench.task(A, B), nothing)


def test_deviations_are_not_computed_before_the_plan_is_sent(bench: Bench) -> None:
    planned = plan_goal(bench.model, bench.task(A), nothing)
    assert planned.points[0].deviation is None
    assert "deviation" not in vars(planned.plan.plan.transitions[0])


def test_a_solver_is_kept_until_tables_or_obstacles_change(bench: Bench) -> None:
    scene = bench.scene(([5.0, 5.0], 0.1))
    kept = bench.model.solver(bench.tables, scene)
    assert bench.model.solver(bench.tables, scene) is kept
    assert kept.clearance is scene.keep_out.clearance
    assert bench.model.solver(bench.tables, scene._replace(generation=100)) is not kept
    assert bench.model.solver(bench.tables, bench.free) is bench.tables.solvers["goals"]


def test_a_search_is_prepared_until_it_is_abandoned(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    task = PrepareSearch(bench.basis())
    for solver in task.basis.tables.solvers.values():
        monkeypatch.setattr(solver, "enumeration", None)  # an arm that is listed whole needs no preparation
    assert prepare_search(bench.model, task, nothing) == Done()
    with pytest.raises(Abandoned):
        prepare_search(bench.model, task, abandoned)


PATH = [A, B, C, A, (2, 2, 1, 0), (5, 1, 4, 0), B, C]


@pytest.fixture
def hasty(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> Planned:
    monkeypatch.setattr(computations, "PLANNING_TIME", 0.0)
    message = bench.goal(*(bench.tip(*c) for c in PATH), tolerance={"position": 0.05})
    return plan_goal(bench.model, bench.task(A, message=message), nothing)


def improving(bench: Bench, planned: Planned, **changes: Any) -> ImprovePlan:
    return ImprovePlan(planned.plan, math.inf, True, bench.tables, bench.free)._replace(**changes)


def improvements(bench: Bench, wanted: ImprovePlan) -> list[Improved]:
    deviations, *improved = improve(bench.model, wanted, nothing)
    assert isinstance(deviations, Deviations)
    return [answer for answer in improved if isinstance(answer, Improved)]


def test_deviations_come_first(bench: Bench, hasty: Planned) -> None:
    (deviations,) = improve(bench.model, improving(bench, hasty, search=False), nothing)
    assert isinstance(deviations, Deviations)
    assert len(deviations.values) == len(PATH)


def test_an_improvement_has_all_points_from_the_first_changed_one(bench: Bench, hasty: Planned) -> None:
    points, costs = list[PlannedPoint](hasty.points), [hasty.proof.cost]
    improved = improvements(bench, improving(bench, hasty))
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
    deviations, *improved = improve(bench.model, improving(bench, planned), nothing)
    assert isinstance(deviations, Deviations)
    assert improved
    assert all(isinstance(answer, Improved) and answer.first >= 1 for answer in improved)


def test_improvements_that_would_collide_are_not_told(
    bench: Bench, hasty: Planned, monkeypatch: pytest.MonkeyPatch
) -> None:
    scene = bench.scene(([5.0, 5.0], 0.1))
    assert improvements(bench, improving(bench, hasty, scene=scene))
    monkeypatch.setattr(type(scene.keep_out), "first_collision", lambda *_: "it collides")
    assert not improvements(bench, improving(bench, hasty, scene=scene))


def test_a_plan_for_other_locked_actuators_is_not_improved(bench: Bench, hasty: Planned) -> None:
    assert not improvements(bench, improving(bench, hasty, tables=bench.tables._replace(generation=2)))


def test_an_abandoned_improvement_ends(bench: Bench, hasty: Planned) -> None:
    with pytest.raises(Abandoned):
        next(improve(bench.model, improving(bench, hasty), abandoned))
    answers = list[Any]()

    def proceed() -> None:
        if answers:
            raise Abandoned

    answering = improve(bench.model, improving(bench, hasty), proceed)
    answers.append(next(answering))
    with pytest.raises(Abandoned):
        next(answering)


def query(bench: Bench, seconds: float = 60.0) -> DescribePlan:
    return DescribePlan(bench.task(A, B), seconds)


@pytest.fixture
def queries(bench: Bench) -> ArmModel:
    return ArmModel(bench.arm, "queries")


def test_a_plan_is_described_point_by_point(bench: Bench, queries: ArmModel) -> None:
    plan = describe(queries, query(bench), nothing, lambda: False).plan
    assert (plan.accepted, len(plan.waypoints)) == (True, 2)
    assert plan.switches == sum(point.switches for point in plan.waypoints)
    assert plan.message == f"2 waypoints, {plan.switches} switches"
    labels = [label for point in plan.waypoints for stage in point.stages for label in stage]
    assert len(labels) == plan.switches


def test_a_description_in_haste_is_one(bench: Bench, queries: ArmModel) -> None:
    assert describe(queries, query(bench), nothing, lambda: True).plan.accepted


def test_a_query_that_takes_too_long_is_refused(bench: Bench, queries: ArmModel) -> None:
    with pytest.raises(Refusal, match=r"planning took longer than -1 s"):
        describe(queries, query(bench, seconds=-1.0), nothing, lambda: False)


def test_an_abandoned_query_ends(bench: Bench, queries: ArmModel) -> None:
    with pytest.raises(Abandoned):
        describe(queries, query(bench), abandoned, lambda: False)
