"""Sent obstacles, on a played executor."""

import json
from typing import Any

from controller.motion import codes
from controller.program import (
    Cancel,
    Clearance,
    Question,
    Replaced,
    Replacement,
)
from tests.planning.conftest import Desk
from tests.planning.test_goals import A, B, taken

HOME = (0, 0, 0, 0)


def obstacles(desk: Desk, *discs: tuple[list[float], float]) -> dict[str, Any]:
    regions = [
        {"disc": {"centre": centre, "radius": radius}, "name": f"d{k}"} for k, (centre, radius) in enumerate(discs)
    ]
    desk.planning.obstacles(json.dumps({"regions": regions}).encode(), desk.inbox.replying("obstacles"))
    return desk.inbox.next("obstacles")


def test_obstacles_are_counted_and_the_same_again_changes_nothing(desk: Desk) -> None:
    assert obstacles(desk, ([5, 5], 0.1))["message"] == "1 obstacle, 1 of them sent"
    generation = desk.planning._keep_out.current.generation
    assert obstacles(desk, ([5, 5], 0.1))["accepted"]
    assert desk.planning._keep_out.current.generation == generation
    sent = [{"disc": {"centre": [5, 5], "radius": 0.1}, "name": "d0"}]
    assert (desk.planning.state()["obstacles"], desk.planning.description()["sent_obstacles"]) == (generation, sent)
    assert obstacles(desk)["message"] == "0 obstacles, 0 of them sent"
    assert desk.planning._keep_out.current.generation == desk.planning.state()["obstacles"] == generation + 1
    assert desk.planning.description()["sent_obstacles"] == []


def test_as_many_obstacles_fit_as_may_be_sent(desk: Desk) -> None:
    reply = obstacles(desk, *[([5.123456789 + k, 5.987654321], 0.123456789) for k in range(256)])
    assert reply["message"] == "256 obstacles, 256 of them sent"
    desk.planning.obstacles(b" " * 1_000_000, desk.inbox.replying("obstacles"))
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
    (fault,) = desk.planning.state()["faults"]
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
