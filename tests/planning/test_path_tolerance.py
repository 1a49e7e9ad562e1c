"""Goals with a path tolerance, on a played executor."""

from hyperbit.controller.program import Cancel, Program, Replacement
from hyperbit.controller.refusals import codes
from tests.planning.rig.desk import Desk


def begun(desk: Desk) -> Program:
    """Sends a goal of two waypoints, which begins."""
    waypoints = [{"t": 2.0 * k, "position": p} for k, p in enumerate((desk.tip(0, 0, 0, 0), desk.tip(0, 0, 0, 7)))]
    desk.ask("goal", {"id": "p", "waypoints": waypoints, "path_tolerance": 0.15, "tolerance": {"position": 0.05}})
    program = desk.executor.expect(Program)
    desk.executor.accept(program)
    assert desk.inbox.next("reply")["accepted"]
    return program


def test_a_tip_off_its_path_ends_the_goal(desk: Desk) -> None:
    program, away = begun(desk), desk.bits(3, 3, 3, 3).to_bytes(2, "little")
    desk.executor.run(program, 0, measured=away)
    desk.inbox.next("feedback")
    cancel = desk.executor.expect(Cancel, Replacement)
    assert cancel.program == program.program
    desk.executor.end(program, "canceled", cancel.reason, mark=0, measured=away)
    result = desk.inbox.next("result")
    assert (result["status"], result["code"]) == ("aborted", codes.PATH_TOLERANCE_VIOLATED)
    assert result["message"].startswith("after waypoints[0] the measured tip is ")
    desk.settle()
    assert "left its path" in desk.state()["reason"]


def test_a_tip_within_its_path_tolerance_lets_the_goal_go_on(desk: Desk) -> None:
    program = begun(desk)
    for waypoint in (0, 1):
        desk.executor.run(program, waypoint)
        assert desk.inbox.next("feedback")["waypoint"] == waypoint
    desk.executor.end(program)
    assert desk.inbox.next("result")["status"] == "succeeded"
