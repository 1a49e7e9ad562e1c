"""Goals on a played executor: programs, answers, feedback, and exactly one result."""

from collections.abc import Callable

import pytest

from hyperbit.controller.motion.decoding.goal import BEGIN_WITHIN
from hyperbit.controller.planning.core.events import Answered
from hyperbit.controller.planning.core.tasks import ImprovePlan, PlanGoal
from hyperbit.controller.program import Acknowledge, Cancel, Program, Replacement, Reset, Stop, unpack
from hyperbit.controller.refusals import codes
from hyperbit.controller.refusals.reasons import Reason
from hyperbit.controller.workspace.densities import Densities
from tests.planning.rig.desk import Desk

A, B, C = (1, 2, 0, 0), (3, 4, 0, 1), (7, 0, 2, 0)


def taken(desk: Desk, *configurations: tuple[int, ...], **fields: object) -> Program:
    desk.goal(*configurations, **fields)  # type: ignore[arg-type]
    program = desk.executor.expect(Program)
    desk.executor.accept(program)
    assert desk.inbox.next("reply")["accepted"]
    return program


def test_a_goal_that_nothing_verifies_says_so(desk: Desk) -> None:
    program = taken(desk, A)
    desk.executor.run(program, 0)
    assert desk.inbox.next("feedback")["waypoint"] == 0
    desk.executor.end(program, verified=False, switches=2)
    result = desk.inbox.next("result")
    assert result["status"] == "succeeded"
    assert result["message"].endswith("; commanded, not verified")


def test_a_goal_becomes_a_program_and_its_result_is_told_once(desk: Desk) -> None:
    assert desk.state()["progress"] is None
    desk.goal(A, B)
    program = desk.executor.expect(Program)
    assert (program.start, program.epoch, program.begin, program.name) == (bytes(2), 1, 0.0, "goal a")
    assert (program.final, program.strict) == (True, False)
    assert [stage.mark for stage in program.stages] == [0, 1]
    first, second = program.stages
    assert (first.at, second.at) == (pytest.approx(0.0), pytest.approx(0.2))
    assert (first.settled, second.settled) == (pytest.approx(0.06), pytest.approx(0.26))
    desk.executor.accept(program)
    reply = desk.inbox.next("reply")
    assert (reply["id"], reply["accepted"], reply["message"][:22]) == ("a", True, "accepted, 2 waypoints,")
    desk.settle()
    progress = desk.state()["progress"]
    assert (progress["waypoints"], progress["reached"]) == (2, 0)
    assert progress["ends"] - progress["begins"] == pytest.approx(0.26, abs=0.11), "both are rounded to 0.1 s"
    desk.executor.run(program, 0)
    told = desk.inbox.next("feedback")
    assert (told["id"], told["waypoint"], told["waypoints"], told["stages"]) == ("a", 0, 2, 1)
    assert told["error"] <= 0.002
    assert told["excursion"] >= 0
    assert 0.0 <= told["remaining"] <= 0.27
    assert told["orientation_error"] is None
    desk.settle()
    assert (desk.state()["goal"], desk.state()["waypoint"]) == ("a", 0)
    assert desk.state()["progress"]["reached"] == 1
    desk.executor.run(program, 1, switches=3)
    assert desk.inbox.next("feedback")["waypoint"] == 1
    ended = desk.executor.end(program, switches=3)
    result = desk.inbox.next("result")
    assert (result["id"], result["status"], result["code"], result["switches"]) == ("a", "succeeded", 0, 3)
    assert result["message"] == "reached"
    assert desk.executor.expect(Acknowledge, Replacement).result == ended.result
    desk.executor.send(ended)  # once more, as to a planner that has reconnected
    assert desk.executor.expect(Acknowledge).result == ended.result
    desk.settle()
    assert desk.inbox.empty
    assert (desk.state()["mode"], desk.state()["reason"]) == ("ready", "holding; goal a was reached")
    (_, accepted), (_, ended_entry), (_, again) = desk.entries
    assert (accepted.accepted.goal, accepted.accepted.waypoints, accepted.ended) == ("a", 2, None)
    assert ended_entry.ended[1:] == again.ended[1:] == ("succeeded", 0, "reached", 3)
    assert len({entry.identity for _, entry in desk.entries}) == 1


def test_a_tip_measured_elsewhere_misses_the_goal(desk: Desk) -> None:
    program = taken(desk, A)
    away = (desk.bits(*B)).to_bytes(2, "little")
    desk.executor.run(program, 0, measured=away)
    desk.inbox.next("feedback")
    desk.executor.end(program)
    result = desk.inbox.next("result")
    assert (result["status"], result["code"]) == ("aborted", codes.GOAL_TOLERANCE_VIOLATED)
    assert "from the last waypoint" in result["message"]


def test_a_goal_is_sent_again_from_where_the_arm_has_moved_to(desk: Desk) -> None:
    desk.goal(A)
    first = desk.executor.expect(Program)
    desk.executor.decline(first, Reason.MOVED_SINCE_PLANNED)
    desk.executor.show(outputs=desk.bits(*C))
    second = desk.executor.expect(Program)
    assert second.program > first.program
    assert second.start == desk.bits(*C).to_bytes(2, "little")
    switches = (unpack(second.start) ^ unpack(second.stages[-1].states)).bit_count()
    desk.executor.accept(second)
    assert desk.inbox.next("reply")["message"] == f"accepted, 1 waypoint, {switches} switches planned"
    desk.executor.run(second, 0, switches=switches)
    desk.inbox.next("feedback")
    desk.executor.end(second, switches=switches)
    result = desk.inbox.next("result")
    assert (result["certificate"], result["lower_bound"]) == ("optimal", switches)


@pytest.mark.parametrize("moves", [0, 1])
def test_a_goal_that_never_catches_up_is_refused_with_the_executors_reason(desk: Desk, moves: int) -> None:
    desk.goal(A)
    until = desk.now + BEGIN_WITHIN
    for k in range(1_000):
        if desk.now >= until:
            break
        desk.executor.decline(desk.executor.expect(Program), Reason.MOVED_SINCE_PLANNED)
        desk.pass_time(0.1)
        desk.executor.show(outputs=desk.bits(moves * k % 8, 0, 0, 0))
    assert desk.inbox.next("reply")["reason"] == "arm-moved"
    desk.executor.messages.clear()
    desk.pass_time(BEGIN_WITHIN)
    assert desk.executor.nothing(Program)


@pytest.mark.parametrize(
    ("reason", "facts", "words"),
    [
        (Reason.OVERTAKEN, {}, "a cancel, stop, reset or fault, or the loss of the planner, came before it began"),
        (Reason.ARM_STOPPED, {"why": "because"}, "the arm is stopped: because"),
        (Reason.PROGRAM_LOCKED, {"misfit": "because"}, "because"),
        (Reason.PROGRAM_MALFORMED, {"misfit": "because"}, "because"),
    ],
)
def test_a_goal_that_is_declined_is_refused_with_the_reason(
    desk: Desk, reason: Reason, facts: dict[str, str], words: str
) -> None:
    desk.goal(A)
    desk.executor.decline(desk.executor.expect(Program), reason, **facts)
    reply = desk.inbox.next("reply")
    assert (reply["accepted"], reply["code"], reply["message"]) == (False, codes.INVALID_GOAL, words)
    assert reply["reason"] == reason.value


@pytest.mark.parametrize("mode", ["starting", "fault", "stopped"])
def test_a_mode_that_takes_no_goal_refuses_it_with_its_reason(desk: Desk, mode: str) -> None:
    desk.show(mode=mode, reason="because")
    desk.goal(A)
    reply = desk.inbox.next("reply")
    assert reply["reason"] in ("arm-starting", "arm-in-fault", "arm-stopped")
    assert reply["message"] in (f"the arm is {mode}: because", f"the arm is in {mode}: because")


def test_a_cancel_bars_what_came_before_it_and_nothing_that_comes_after(desk: Desk) -> None:
    desk.goal(A, name="before")
    program = desk.executor.expect(Program)
    desk.ask("cancel", name="canceled")
    desk.goal(B, name="after")
    cancel = desk.executor.expect(Cancel)
    assert (cancel.program, cancel.reason) == (None, "canceled; the arm holds")
    desk.executor.decline(program, Reason.OVERTAKEN)
    assert desk.inbox.next("reply")["reason"] == "overtaken"
    desk.executor.answer(cancel, "there was no goal to cancel; the arm holds")
    assert desk.inbox.next("canceled")["message"] == "there was no goal to cancel; the arm holds"
    after = desk.executor.expect(Program)
    assert (after.epoch, after.name) == (2, "goal after")


def test_a_cancel_ends_the_running_goal(desk: Desk) -> None:
    program = taken(desk, A, B)
    desk.ask("cancel", name="canceled")
    cancel = desk.executor.expect(Cancel, Replacement)
    desk.executor.end(program, "canceled", cancel.reason, mark=0)
    result = desk.inbox.next("result")
    assert (result["status"], result["code"], result["message"]) == ("canceled", -1, "canceled; the arm holds")
    desk.executor.answer(cancel, "canceled")
    assert desk.inbox.next("canceled") == {"accepted": True, "code": 0, "message": "canceled"}


@pytest.mark.parametrize(("status", "code"), [("aborted", -4), ("replaced", -1), ("canceled", -1)])
def test_an_end_before_the_last_waypoint_is_told_with_its_reason(desk: Desk, status: str, code: int) -> None:
    program = taken(desk, A, B)
    desk.executor.end(program, status, "words", mark=-1)
    result = desk.inbox.next("result")
    assert (result["status"], result["code"], result["message"]) == (status, code, "words")
    assert result["configuration"] == "0000"


def test_stop_and_reset_go_straight_to_the_executor(desk: Desk) -> None:
    desk.ask("stop", name="stop")
    halt = desk.executor.expect(Stop)
    desk.executor.answer(halt, "stopped; the arm holds until reset", mode="stopped", reason="a stop was requested")
    assert desk.inbox.next("stop")["message"] == "stopped; the arm holds until reset"
    desk.settle()
    desk.ask("reset", name="reset")
    reset = desk.executor.expect(Reset)
    desk.executor.answer(reset, "resetting", mode="starting", reason="booting")
    assert desk.inbox.next("reset")["accepted"]


def test_a_second_goal_of_the_running_id_is_refused(desk: Desk) -> None:
    taken(desk, A, B, step=10)
    desk.goal(C)
    assert "is running already" in desk.inbox.next("reply")["message"]


def test_an_executor_that_dies_aborts_the_goal_once_and_its_late_result_is_acknowledged(desk: Desk) -> None:
    program = taken(desk, A, B, step=10)
    desk.drop()
    result = desk.inbox.next("result")
    assert (result["status"], result["code"]) == ("aborted", codes.PATH_TOLERANCE_VIOLATED)
    assert result["message"] == "the executor closed the connection"
    desk.executor.greet(program.program)
    ended = desk.executor.end(program, "aborted", "the planner is gone", mark=-1)
    assert desk.executor.expect(Acknowledge, Replacement).result == ended.result
    assert desk.inbox.empty


def test_the_result_of_another_run_of_the_planner_is_published(
    desk: Desk, make_desk: Callable[..., Desk], small_densities: Densities
) -> None:
    program = taken(desk, A)
    later = make_desk(desk.arm, small_densities)
    later.executor.show(outputs=program.stages[-1].states)
    ended = later.executor.end(program)
    result = later.inbox.next("inherited")
    assert (result["id"], result["status"], result["error"] <= 0.002) == ("a", "succeeded", True)
    assert later.executor.expect(Acknowledge).result == ended.result
    ((_, entry),) = later.entries
    assert (entry.accepted.goal, entry.accepted.waypoints, entry.ended.status) == ("a", 1, "succeeded")


def test_a_goal_of_a_configuration_is_reached_by_that_one_only(desk: Desk) -> None:
    for name, status in (("1200", "succeeded"), ("1201", "aborted")):
        desk.ask("goal", {"id": name, "waypoints": [{"configuration": "1200"}]})
        program = desk.executor.expect(Program, Replacement, Acknowledge)
        assert program.stages[-1].states == desk.bits(1, 2, 0, 0).to_bytes(2, "little")
        desk.executor.accept(program)
        assert desk.inbox.next("reply")["accepted"]
        at = desk.bits(*map(int, name)).to_bytes(2, "little")
        desk.executor.run(program, 0, measured=at)
        desk.inbox.next("feedback")
        desk.executor.end(program)
        assert desk.inbox.next("result")["status"] == status
        desk.show(outputs=0)


def test_too_many_goals_are_refused_at_once(desk: Desk) -> None:
    desk.goal(A)
    program = desk.executor.expect(Program)
    for _ in range(16):
        desk.goal(B)
    desk.ask("goal", b"{}", "flood")
    assert desk.inbox.next("flood")["message"] == "waypoints: required, but missing"
    desk.ask("goal", b'{"waypoints": []}', "flood")
    assert desk.inbox.next("flood")["message"] == "busy: 16 goals are waiting already"
    far = b'{"id": "far", "waypoints": [{"configuration": "0"}, {"position": [90, 0]}]}'
    for key in ("goal", "plan"):  # a goal beyond the arm's length takes no place in the queue
        desk.ask(key, far, "flood")
        answer = desk.inbox.next("flood")
        assert (answer["id"], answer["code"]) == ("far", codes.GOAL_TOLERANCE_VIOLATED)
        assert "waypoints[1].position: (90, 0) is out of reach: 90 from the base, " in answer["message"]
    desk.ask("goal", b" " * 2_000_000, "flood")
    assert "2000000 bytes" in desk.inbox.next("flood")["message"]
    desk.ask("cancel", name="canceled")
    desk.executor.decline(program, Reason.OVERTAKEN)
    cancel = desk.executor.expect(Cancel)
    assert [desk.inbox.next("reply")["reason"] for _ in range(17)] == ["overtaken"] * 17
    desk.executor.answer(cancel, "canceled")


def test_closing_ends_the_running_goal_with_a_result(desk: Desk) -> None:
    program = taken(desk, A, B, step=10)
    desk.quit()
    cancel = desk.executor.expect(Cancel, Replacement)
    assert not desk.core.ended
    desk.executor.end(program, "canceled", cancel.reason, mark=-1)
    result = desk.inbox.next("result")
    assert desk.core.ended
    assert (result["status"], result["message"]) == ("aborted", "the daemon is shutting down")


def test_the_last_state_tells_no_fault_that_the_log_does_not(desk: Desk) -> None:
    desk.drop("the executor died")
    desk.quit()
    assert desk.core.ended
    assert [fault["code"] for fault in desk.published["state"]["faults"]] == ["executor-lost"]
    assert any(line.startswith("executor-lost: the executor died") for line in desk.logs)


def test_the_numbers_of_a_proof_are_pythons(desk: Desk) -> None:
    desk.held.add(PlanGoal)
    desk.goal(A)
    (task,) = [task for task in desk.queued.values() if isinstance(task, PlanGoal)]
    (planned,) = desk.workers.perform(task)
    assert [type(value) for value in planned.proof] == [int, float, float, str]


def test_a_plan_that_cannot_be_offered_is_an_internal_error_and_ends_nothing(desk: Desk) -> None:
    desk.held.add(PlanGoal)
    desk.goal(A)
    ((number, task),) = [(n, task) for n, task in desk.queued.items() if isinstance(task, PlanGoal)]
    (planned,) = desk.workers.perform(task)
    desk.post(Answered(number, planned._replace(proof=object()), True))
    assert desk.inbox.next("reply")["message"] == "internal error, see the journal"
    assert "Traceback" in desk.logs[-2]
    desk.held.clear()
    desk.goal(B, name="b")
    assert desk.executor.expect(Program).name == "goal b"


@pytest.mark.parametrize("key", ["goal", "obstacles"])
def test_a_result_that_waits_for_deviations_is_published_when_another_request_ends_the_wait(
    desk: Desk, key: str
) -> None:
    desk.held.add(ImprovePlan)
    program = taken(desk, A)
    desk.executor.run(program, 0)
    desk.executor.end(program)
    assert desk.inbox.empty
    if key == "goal":
        desk.goal(B, name="b")
    else:
        desk.ask("obstacles", {"regions": [{"disc": {"centre": [50.0, 50.0], "radius": 0.1}}]}, "obstacles")
    assert desk.inbox.next("feedback")["waypoint"] == 0
    assert desk.inbox.next("result")["status"] == "succeeded"
