"""Sent obstacles, on a played executor."""

from typing import Any

import numpy as np
import pytest

from hyperbit.controller.planning.core.tasks import BuildScene, CheckStages, CheckStanding, PlanGoal
from hyperbit.controller.planning.workers import computations
from hyperbit.controller.program import Begun, Cancel, Clearance, Program, Question, Replaced, Replacement, unpack
from hyperbit.controller.refusals import codes
from tests.planning.rig.desk import Desk
from tests.planning.test_goals import A, B, taken

HOME = (0, 0, 0, 0)


def obstacles(desk: Desk, *discs: tuple[list[float], float]) -> dict[str, Any]:
    send(desk, *discs)
    return desk.inbox.next("obstacles")


def send(desk: Desk, *discs: tuple[list[float], float]) -> None:
    regions = [
        {"disc": {"centre": centre, "radius": radius}, "name": f"d{k}"} for k, (centre, radius) in enumerate(discs)
    ]
    desk.ask("obstacles", {"regions": regions}, "obstacles")


def described(desk: Desk) -> dict[str, Any]:
    desk.ask("arm")
    return desk.inbox.next("reply")


def test_obstacles_are_counted_and_the_same_again_changes_nothing(desk: Desk) -> None:
    assert obstacles(desk, ([5, 5], 0.1))["message"] == "1 obstacle, 1 of them sent"
    generation = desk.state()["obstacles"]
    assert obstacles(desk, ([5, 5], 0.1))["accepted"]
    assert desk.state()["obstacles"] == generation
    sent = [{"disc": {"centre": [5, 5], "radius": 0.1}, "name": "d0"}]
    assert (desk.state()["obstacles"], described(desk)["sent_obstacles"]) == (generation, sent)
    assert obstacles(desk)["message"] == "0 obstacles, 0 of them sent"
    assert desk.state()["obstacles"] == desk.state()["obstacles"] == generation + 1
    assert described(desk)["sent_obstacles"] == []


def test_as_many_obstacles_fit_as_may_be_sent(desk: Desk) -> None:
    reply = obstacles(desk, *[([5.123456789 + k, 5.987654321], 0.123456789) for k in range(256)])
    assert reply["message"] == "256 obstacles, 256 of them sent"
    desk.ask("obstacles", b" " * 1_000_000, "obstacles")
    assert "1000000 bytes" in desk.inbox.next("obstacles")["message"]


def test_a_running_goal_whose_rest_touches_is_ended(desk: Desk) -> None:
    program = taken(desk, A, B, step=10)
    obstacles(desk, (desk.tip(*B), 0.03))
    cancel = desk.executor.expect(Cancel, Replacement)
    assert cancel.program == program.program
    desk.executor.end(program, "canceled", cancel.reason, mark=-1)
    result = desk.inbox.next("result")
    assert (result["status"], result["code"]) == ("aborted", codes.PATH_TOLERANCE_VIOLATED)
    assert "is in disc 'd0'" in result["message"]


def test_a_running_goal_whose_rest_is_clear_goes_on_strictly(desk: Desk) -> None:
    program = taken(desk, A, B, step=10)
    obstacles(desk, ([5, 5], 0.1))
    while not (message := desk.executor.expect(Replacement)).strict:  # look-ahead may have sent one before
        desk.executor.send(Replaced(message.program, message.generation, True))
    assert message.program == program.program
    assert desk.executor.nothing(Cancel)


def test_a_goal_among_obstacles_is_strict_and_clear(desk: Desk) -> None:
    obstacles(desk, ([5, 5], 0.1))
    assert taken(desk, A).strict


def test_an_arm_in_an_obstacle_says_so_and_takes_no_goal(desk: Desk) -> None:
    reply = obstacles(desk, (desk.tip(*HOME), 0.02))
    assert "is in disc 'd0' where the arm stands" in reply["message"]
    (fault,) = desk.state()["faults"]
    assert (fault["code"], fault["source"]) == ("in-obstacle", "arm")
    desk.goal(A)
    assert "disc 'd0'" in desk.inbox.next("reply")["message"]


def test_the_executors_questions_are_answered(desk: Desk) -> None:
    home, b = bytes(2), desk.bits(*B).to_bytes(2, "little")
    desk.executor.send(Question(1, home, b))
    assert desk.executor.expect(Clearance) == Clearance(1, None)
    obstacles(desk, (desk.tip(*B), 0.03))
    desk.executor.send(Question(2, home, b))
    answer = desk.executor.expect(Clearance)
    assert answer.question == 2
    assert "is in disc 'd0'" in (answer.touched or "")


def park(desk: Desk, program: Program) -> Replacement:
    """Receives the message that withdraws all stages that have not begun, and accepts it."""
    while True:
        message = desk.executor.expect(Replacement)
        desk.executor.send(Replaced(program.program, message.generation, True))
        if not message.stages:
            assert (message.final, message.strict) == (False, True)
            return message


def test_a_program_that_was_only_offered_is_parked_and_checked(desk: Desk) -> None:
    desk.goal(A, B, step=10)
    program = desk.executor.expect(Program)
    send(desk, (desk.tip(*B), 0.03))
    assert desk.inbox.empty, "the answer says what became of the goal"
    desk.executor.accept(program)
    assert park(desk, program).first == 0
    assert desk.executor.expect(Cancel, Replacement).program == program.program
    assert desk.inbox.next("reply")["accepted"]
    assert "goal a was aborted: it would collide: " in desk.inbox.next("obstacles")["message"]


def test_a_replacement_that_was_only_sent_is_parked_and_checked(desk: Desk, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(computations, "PLANNING_TIME", 0.0)  # the first plan has switches to save
    desk.goal((7, 3, 4, 3), (2, 2, 5, 1), (1, 5, 4, 2), (2, 6, 0, 2), (4, 5, 4, 4), step=10)
    program = desk.executor.expect(Program)
    desk.executor.accept(program)
    better = desk.executor.expect(Replacement)  # of look-ahead; not answered yet
    assert desk.inbox.next("reply")["accepted"]
    desk.executor.send(Begun(program.program, 0, 1))
    desk.executor.show(outputs=program.stages[0].states)
    end = better.stages[-1].states
    states = np.array([unpack(end) >> k & 1 for k in range(desk.executor.actuators)])
    tip = desk.arm.manipulator.tip(desk.arm.manipulator.configuration(states))[:2, 3].tolist()
    send(desk, (tip, 0.004))
    desk.executor.send(Replaced(program.program, better.generation, True))
    assert desk.executor.expect(Cancel).program == program.program
    assert desk.executor.nothing(Replacement)


def test_stages_come_back_as_their_check_finds_them_clear(desk: Desk) -> None:
    desk.goal(A, B, step=10)
    program = desk.executor.expect(Program)
    desk.executor.accept(program)
    desk.inbox.next("reply")
    desk.held.add(CheckStages)
    send(desk, ([5, 5], 0.1))
    parked = park(desk, program)
    assert desk.executor.nothing(Replacement)
    assert desk.inbox.empty
    desk.release(CheckStages)
    back = desk.executor.expect(Replacement)
    assert (back.first, len(back.stages), back.final, back.strict) == (parked.first, 2, True, True)
    words = "1 obstacle, 1 of them sent; goal a goes on, its stages are clear"
    assert desk.inbox.next("obstacles")["message"] == words


def test_obstacles_that_change_again_begin_the_check_anew(desk: Desk) -> None:
    program = taken(desk, A, B, step=10)
    desk.held.add(CheckStages)
    send(desk, ([5, 5], 0.1))
    park(desk, program)
    send(desk, (desk.tip(*B), 0.03))
    desk.release(CheckStages)
    assert desk.executor.expect(Cancel, Replacement).program == program.program
    messages = [desk.inbox.next("obstacles")["message"] for _ in range(2)]
    assert all("goal a was aborted" in message for message in messages)


def test_a_jog_under_way_is_checked(desk: Desk) -> None:
    desk.ask("jog", {"actuators": {"1.left": "extended"}})
    program = desk.executor.expect(Program)
    desk.executor.accept(program)
    jog = desk.inbox.next("reply")["id"]
    reached = [unpack(program.stages[-1].states) >> k & 1 for k in range(desk.executor.actuators)]
    tip = desk.arm.manipulator.tip(desk.arm.manipulator.configuration(np.array(reached)))[:2, 3].tolist()
    send(desk, (tip, 0.004))
    park(desk, program)
    assert desk.executor.expect(Cancel).program == program.program
    assert f"goal {jog} was aborted" in desk.inbox.next("obstacles")["message"]


def test_a_goal_that_is_being_planned_is_planned_among_the_new_obstacles(desk: Desk) -> None:
    desk.held.add(PlanGoal)
    desk.goal(A)
    send(desk, ([5, 5], 0.1))
    assert desk.inbox.next("obstacles")["accepted"]
    desk.release(PlanGoal)
    assert desk.executor.expect(Program).strict


def test_a_question_is_answered_for_the_obstacles_that_hold_then(desk: Desk) -> None:
    obstacles(desk, ([5, 5], 0.1))
    desk.held.add(CheckStages)
    desk.executor.send(Question(7, bytes(2), desk.packed(*B)))
    send(desk, (desk.tip(*B), 0.03))
    desk.release(CheckStages)
    answer = desk.executor.expect(Clearance)
    assert "is in disc 'd0'" in (answer.touched or "")
    assert desk.executor.nothing(Clearance)


def test_obstacles_that_cannot_be_checked_are_refused_and_change_nothing(desk: Desk) -> None:
    desk.failing.add(BuildScene)
    reply = obstacles(desk, ([5, 5], 0.1))
    assert (reply["accepted"], reply["message"][:31]) == (False, "the obstacles cannot be checked")
    desk.failing.clear()
    desk.goal(A)
    assert not desk.executor.expect(Program).strict


def test_after_obstacles_that_cannot_be_checked_those_before_can_be_removed(desk: Desk) -> None:
    obstacles(desk, ([5, 5], 0.1))
    before = described(desk)["sent_obstacles"]
    desk.failing.add(BuildScene)
    assert not obstacles(desk, ([6, 6], 0.1))["accepted"]
    assert described(desk)["sent_obstacles"] == before
    desk.failing.clear()
    assert obstacles(desk)["message"] == "0 obstacles, 0 of them sent"
    assert described(desk)["sent_obstacles"] == []


def test_obstacles_are_confirmed_only_when_they_are_built(desk: Desk) -> None:
    desk.held.add(BuildScene)
    send(desk, ([5, 5], 0.1))
    desk.pass_time(10.0)
    assert desk.inbox.empty
    desk.failing.add(BuildScene)
    desk.release(BuildScene)
    assert not desk.inbox.next("obstacles")["accepted"]


def test_a_failed_check_of_where_the_arm_stands_is_made_again(desk: Desk) -> None:
    def codes_told() -> list[str]:
        return [fault["code"] for fault in desk.state()["faults"]]

    desk.failing = {CheckStanding}
    obstacles(desk, ([0.0, 0.0], 5.0))
    assert codes_told() == []
    desk.failing = set()
    desk.pass_time(0.8)
    assert codes_told() == []
    desk.pass_time(0.3)
    assert codes_told() == ["in-obstacle"]
