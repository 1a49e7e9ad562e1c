"""Plan queries, which move nothing, on a played executor."""

import numpy as np

from hyperbit.controller.motion.plans import whole
from hyperbit.controller.motion.plans.transitions import TransitionPlanner
from hyperbit.controller.motion.stages.pacing import pace_of
from hyperbit.controller.planning.core.tasks import DescribePlan
from hyperbit.controller.program import Program
from hyperbit.controller.search.solver import Solver
from tests.planning.rig.desk import Desk

A, B = (1, 2, 0, 0), (3, 4, 0, 1)


def test_a_cancel_ends_a_plan_query_by_its_id(desk: Desk) -> None:
    desk.held.add(DescribePlan)
    desk.ask("plan", {"id": "study", "waypoints": [{"position": desk.tip(*B)}]}, "plan")
    desk.ask("cancel", {"id": "other"}, name="canceled")
    assert desk.inbox.next("canceled")["message"] == "goal other is not running"
    desk.ask("cancel", {"id": "study"}, name="canceled")
    answer = desk.inbox.next("plan")
    assert (answer["accepted"], answer["reason"], answer["id"]) == (False, "plan-canceled", "study")
    assert desk.inbox.next("canceled")["message"] == "the plan is canceled"
    desk.release(DescribePlan)
    assert desk.inbox.empty


def test_a_plan_query_is_refused_at_the_end(desk: Desk) -> None:
    desk.held.add(DescribePlan)
    desk.ask("plan", {"id": "study", "waypoints": [{"position": desk.tip(*B)}]}, "plan")
    assert desk.inbox.empty
    desk.quit()
    answer = desk.inbox.next("plan")
    assert (answer["accepted"], answer["reason"], answer["id"]) == (False, "shutting-down", "study")


def test_a_plan_query_is_answered_while_goals_wait(desk: Desk) -> None:
    desk.goal(A)
    program = desk.executor.expect(Program)  # the planner waits for the executor's answer
    payload = {"waypoints": [{"position": desk.tip(*B)}]}
    desk.ask("plan", payload, "plan")
    answer = desk.inbox.next("plan")
    assert answer["accepted"]
    assert [w["t"] for w in answer["waypoints"]] == [0]
    desk.executor.accept(program)
    assert desk.inbox.next("reply")["accepted"]


def test_a_plan_query_is_answered_as_plans_are_made_elsewhere(desk: Desk, small_densities, monkeypatch) -> None:
    monkeypatch.setattr(whole, "WHOLE_TIME", 60.0)  # so that both prove the fewest switches on any machine
    manipulator = desk.arm.reduced
    positions = np.array([desk.tip(*row) for row in ((1, 2, 3, 4), (5, 6, 7, 0), (1, 2, 0, 0))])
    waypoints = [{"t": 10 * k, "position": position.tolist()} for k, position in enumerate(positions)]
    desk.ask("plan", {"waypoints": waypoints}, "plan")
    answer = desk.inbox.next("plan")
    goals = whole.TipGoals(positions, np.full(3, 0.002), np.tile(np.eye(3), (3, 1, 1)), np.full(3, np.inf))
    pace = pace_of(desk.arm.settings)
    solver, home = Solver(manipulator, small_densities), np.zeros(4, dtype=np.int64)
    plan = whole.plan_whole(TransitionPlanner(solver, whole.unhurried(goals, pace), pace), home, "minimum-switch")
    assert answer["certificate"] == plan.certificate == "optimal"
    assert answer["switches"] == answer["lower_bound"] == plan.switches
