"""The time of planning: a waiting goal hurries the search before it, and planning that takes too long is refused."""

import pytest

from hyperbit.controller.planning.core.tasks import PlanGoal
from hyperbit.controller.program import Program
from hyperbit.controller.refusals.reasons import Reason
from tests.planning.rig.desk import Desk
from tests.planning.test_goals import A, B, C


def test_a_goal_that_waits_hurries_the_search_before_it(desk: Desk) -> None:
    """Both orders: a goal arrives while another is searched, and a search begins while others wait."""
    desk.held = {PlanGoal}
    desk.goal(A, name="a")
    assert desk.hurried == []
    desk.goal(B, name="b")
    desk.goal(C, name="c")
    assert len(set(desk.hurried)) == 1
    desk.held = set()
    desk.release(PlanGoal)
    desk.executor.decline(desk.executor.expect(Program), Reason.OVERTAKEN)
    desk.executor.decline(desk.executor.expect(Program), Reason.OVERTAKEN)
    desk.executor.expect(Program)
    assert len(set(desk.hurried)) == 2


@pytest.mark.parametrize(
    ("fields", "longest"), [({}, 8.0), ({"deadline": 50.0}, 58.0), ({"deadline": 50.0, "begin_within": 3.0}, 3.0)]
)
def test_a_goal_that_cannot_begin_in_time_is_refused(desk: Desk, fields: dict[str, float], longest: float) -> None:
    """The one that is planned, and the one that waits behind it."""
    desk.held = {PlanGoal}
    desk.goal(A, name="a", **fields)
    desk.goal(B, name="b", **fields)
    desk.pass_time(longest - 0.1)
    assert desk.inbox.empty
    desk.pass_time(0.2)
    assert [desk.inbox.next("reply")["reason"] for _ in range(2)] == ["too-late-to-begin"] * 2
    desk.release(PlanGoal)
    assert desk.executor.nothing(Program)


def test_a_program_tells_the_executor_until_when_it_may_begin(desk: Desk) -> None:
    began = desk.now
    desk.goal(A, begin_within=3.0)
    assert desk.executor.expect(Program).until == began + 3.0


def test_a_goal_that_arrived_while_the_process_stood_still_has_less_time(desk: Desk) -> None:
    desk.delay = 9.0
    desk.goal(A)
    assert desk.inbox.next("reply")["reason"] == "too-late-to-begin"
    desk.goal(A, begin_within=10.0)
    assert desk.executor.expect(Program)


def test_obstacles_end_a_stale_search_at_once_and_its_deadline_counts_on(desk: Desk) -> None:
    desk.held = {PlanGoal}
    desk.goal(A, name="a", deadline=5.0)
    lefts = []
    for k in range(5):
        ((number, task),) = [(n, t) for n, t in desk.queued.items() if isinstance(t, PlanGoal)]
        lefts.append(round(task.message.deadline or 0.0, 3))
        desk.pass_time(1.0)
        desk.ask("obstacles", {"regions": [{"disc": {"centre": [9.0, 9.0 + k], "radius": 0.1}}]}, name="obstacles")
        desk.inbox.payloads.clear() if k < 4 else None
        assert number not in desk.queued
    assert lefts == [5.0, 4.0, 3.0, 2.0, 1.0]
    replies = [payload for key, payload in desk.inbox.payloads if key == "reply"]
    assert [reply["reason"] for reply in replies] == ["obstacles-changing"]
