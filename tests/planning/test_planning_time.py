"""The time of planning: a waiting goal hurries the search before it, and planning that takes too long is refused."""

import pytest

from controller.planning.core.tasks import PlanGoal
from controller.program import Program
from controller.refusals.reasons import Reason
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


@pytest.mark.parametrize(("deadline", "longest"), [({}, 60.0), ({"deadline": 50.0}, 110.0)])
def test_planning_that_takes_too_long_is_refused(desk: Desk, deadline: dict[str, float], longest: float) -> None:
    desk.held = {PlanGoal}
    desk.goal(A, name="a", **deadline)
    desk.pass_time(longest - 1.0)
    assert desk.inbox.empty
    desk.pass_time(2.0)
    assert desk.inbox.next("reply")["message"] == f"planning took longer than {longest:g} s"
