"""The planner's core at a desk: what scenarios cannot say, in numbers, loops and states that no configuration has."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from hyperbit.controller.arm.arm import Arm
from hyperbit.controller.motion.decoding.goal import BEGIN_WITHIN
from hyperbit.controller.motion.plans import whole
from hyperbit.controller.motion.plans.transitions import TransitionPlanner
from hyperbit.controller.motion.stages.feed import PlanProof
from hyperbit.controller.motion.stages.pacing import pace_of
from hyperbit.controller.planning.core.events import Answered, Arrival, Request
from hyperbit.controller.planning.core.parts import Admission
from hyperbit.controller.planning.core.results import why_not_as_planned
from hyperbit.controller.planning.core.tasks import PlanGoal
from hyperbit.controller.planning.workers import computations
from hyperbit.controller.program import (
    Acknowledge,
    Begun,
    Cancel,
    Counted,
    Lock,
    Program,
    Replaced,
    Replacement,
    pack,
    unpack,
)
from hyperbit.controller.refusals import codes
from hyperbit.controller.refusals.reasons import Reason
from hyperbit.controller.search.solver import Solver
from hyperbit.controller.workspace.densities import Densities
from tests.planning.conftest import DOCUMENT, JOINT, unused_states
from tests.planning.rig.desk import Desk

A, B, C = (1, 2, 0, 0), (3, 4, 0, 1), (7, 0, 2, 0)


def taken(desk: Desk, *configurations: tuple[int, ...], **fields: Any) -> Program:
    desk.goal(*configurations, **fields)
    program = desk.executor.expect(Program)
    desk.executor.accept(program)
    assert desk.inbox.next("reply")["accepted"]
    return program


def replies(desk: Desk, key: str = "reply") -> list[str | None]:
    return [payload.get("reason") for came, payload in desk.inbox.payloads if came == key]


def test_an_executor_that_has_lost_its_journal_gets_the_latest_counts(desk: Desk) -> None:
    counts = tuple(range(1, 1 + desk.executor.actuators))
    desk.executor.send(Counted(counts))
    desk.executor.greet()
    assert desk.raised == counts
    assert desk.counts == counts


def test_a_goal_is_timed_and_its_progress_is_told(desk: Desk) -> None:
    program = taken(desk, A, B)
    first, second = program.stages
    assert (first.at, second.at, first.mark, second.mark) == (pytest.approx(0.0), pytest.approx(0.2), 0, 1)
    assert (first.settled, second.settled) == (pytest.approx(0.06), pytest.approx(0.26))
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
    state = desk.state()
    assert (state["goal"], state["waypoint"], state["progress"]["reached"]) == ("a", 0, 1)
    desk.executor.run(program, 1, switches=3)
    desk.executor.end(program, switches=3)
    (_, accepted), (_, ended) = desk.entries
    assert (accepted.accepted.goal, accepted.accepted.waypoints, accepted.ended) == ("a", 2, None)
    assert ended.ended[1:] == ("succeeded", 0, "reached", 3)
    assert accepted.identity == ended.identity


@pytest.mark.parametrize(("more", "certificate"), [(0, "optimal"), (3, "unknown")])
def test_a_certificate_stands_only_beside_the_switches_that_it_speaks_of(
    desk: Desk, more: int, certificate: str
) -> None:
    program = taken(desk, A)
    switches = (unpack(program.start) ^ unpack(program.stages[-1].states)).bit_count()
    desk.executor.run(program, 0)
    desk.inbox.next("feedback")
    desk.executor.end(program, switches=switches + more)
    result = desk.inbox.next("result")
    assert (result["certificate"], result["optimal"]) == (certificate, None if more else True)
    assert result["lower_bound"] == (None if more else switches)


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


def test_too_many_goals_are_refused_at_once(desk: Desk) -> None:
    desk.goal(A)
    program = desk.executor.expect(Program)
    for _ in range(16):
        desk.goal(B)
    for payload, words in (
        (b"{}", "waypoints: required, but missing"),
        (b'{"waypoints": []}', "busy: 16 goals are waiting already"),
        (b" " * 2_000_000, "2000000 bytes"),
    ):
        desk.ask("goal", payload, "flood")
        assert words in desk.inbox.next("flood")["message"]
    far = b'{"id": "far", "waypoints": [{"configuration": "0"}, {"position": [90, 0]}]}'
    for key in ("goal", "plan"):  # a goal beyond the arm's length takes no place in the queue
        desk.ask(key, far, "flood")
        answer = desk.inbox.next("flood")
        assert (answer["id"], answer["code"]) == ("far", codes.GOAL_TOLERANCE_VIOLATED)
        assert "waypoint 2, position: (90, 0) is out of reach: 90 from the base, " in answer["message"]
    desk.ask("cancel", name="canceled")
    desk.executor.decline(program, Reason.OVERTAKEN)
    assert [desk.inbox.next("reply")["reason"] for _ in range(17)] == ["overtaken"] * 17
    sent = [{"disc": {"centre": [5.1 + k, 5.9], "radius": 0.1}, "name": f"d{k}"} for k in range(256)]
    desk.ask("obstacles", {"regions": sent}, "obstacles")
    assert desk.inbox.next("obstacles")["message"] == "256 obstacles, 256 of them sent"
    desk.ask("obstacles", b" " * 1_000_000, "obstacles")
    assert "1000000 bytes" in desk.inbox.next("obstacles")["message"]


def test_a_plan_that_cannot_be_offered_is_an_internal_error_and_ends_nothing(desk: Desk) -> None:
    desk.held.add(PlanGoal)
    desk.goal(A)
    ((number, task),) = [(n, task) for n, task in desk.queued.items() if isinstance(task, PlanGoal)]
    (planned,) = desk.workers.perform(task)
    assert [type(value) for value in planned.proof] == [int, float, float, str]
    desk.post(Answered(number, planned._replace(proof=object()), True))
    assert desk.inbox.next("reply")["message"] == "internal error, see the journal"
    assert "Traceback" in desk.logs[-2]
    desk.held.clear()
    desk.goal(B, name="b")
    assert desk.executor.expect(Program).name == "goal b"


@pytest.mark.parametrize("context", [b"", b"\xc1", b"\x81\xa2id\x01"])
def test_a_context_of_another_version_is_logged_and_acknowledged(desk: Desk, context: bytes) -> None:
    program = taken(desk, A)
    ended = desk.executor.end(Program(9, 1, bytes(2), 0.0, program.stages, True, False, "goal z", context))
    assert desk.executor.expect(Acknowledge, Replacement).result == ended.result
    assert "has no context that this planner can decode" in desk.logs[-1]


@pytest.mark.parametrize("key", ["stop", "cancel"])
def test_a_goal_that_arrived_before_a_stop_and_comes_after_it_is_refused(desk: Desk, key: str) -> None:
    number = desk.ask(key, name="stop")
    goal = desk.decode("goal", b'{"id": "late", "waypoints": [{"configuration": "7000"}]}')
    desk.names[number - 1] = "reply"
    desk.post(Request(Arrival(number - 1, desk.now), "goal", goal, desk.wall))
    assert replies(desk) == ["overtaken"]


def test_a_goal_that_arrived_before_the_cancel_of_its_id_is_refused_wherever_it_is(desk: Desk) -> None:
    """Offered and declined; planned; waiting; not yet at the core."""
    desk.goal(A, name="a")
    offered = desk.executor.expect(Program)
    desk.held.add(PlanGoal)
    desk.goal(B, name="a")
    desk.goal(B, name="b")
    number = desk.ask("cancel", {"id": "a"}, name="cancel")
    assert replies(desk) == ["overtaken"]
    cancel = desk.executor.expect(Cancel)
    assert cancel.program == offered.program
    desk.executor.decline(offered, Reason.MOVED_SINCE_PLANNED)
    desk.executor.answer(cancel, f"program {offered.program} is not running")
    assert replies(desk) == ["overtaken"] * 2
    assert replies(desk, "cancel") == [None]
    late = desk.decode("goal", b'{"id": "a", "waypoints": [{"configuration": "7000"}]}')
    desk.names[number - 1] = "reply"
    desk.post(Request(Arrival(number - 1, desk.now), "goal", late, desk.wall))
    desk.release(PlanGoal)
    desk.pass_time(1.0)
    assert {program.name for program in desk.executor.messages if isinstance(program, Program)} <= {"goal b"}


def test_cancels_of_many_ids_and_streams_without_an_executor_leave_nothing(desk: Desk) -> None:
    for number in range(2_000):
        desk.ask("cancel", {"id": f"g{number}"})
    assert len(desk.core.admission.canceled) < 300
    desk.drop()
    for number in range(3_000):
        desk.setpoint(b'{"position": [9.0, 9.0]}' if number % 2 else b"{")
        desk.now += 0.3 * (number % 10 == 0)
    assert len(desk.core.admission.unresolved) < 300


def test_the_loss_of_the_executor_bars_all_that_arrived_before() -> None:
    admission = Admission()
    early = admission.arrive(4)
    admission.lost()
    late = admission.arrive(5)
    assert [admission.barred(ticket) for ticket in (early, late)] == [True, False]


def test_obstacles_end_a_stale_search_at_once_and_its_deadline_counts_on(desk: Desk) -> None:
    desk.held = {PlanGoal}
    desk.goal(A, name="a", deadline=5.0)
    lefts = []
    for k in range(5):
        ((number, task),) = [(n, t) for n, t in desk.queued.items() if isinstance(t, PlanGoal)]
        lefts.append(round(task.message.deadline or 0.0, 3))
        desk.pass_time(1.0)
        desk.ask("obstacles", {"regions": [{"disc": {"centre": [9.0, 9.0 + k], "radius": 0.1}}]}, name="obstacles")
        assert number not in desk.queued
    assert lefts == [5.0, 4.0, 3.0, 2.0, 1.0]
    assert replies(desk) == ["obstacles-changing"]


def test_a_replacement_that_was_only_sent_is_parked_and_checked(desk: Desk, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(computations, "PLANNING_TIME", 0.0)  # the first plan has switches to save
    program = taken(desk, (7, 3, 4, 3), (2, 2, 5, 1), (1, 5, 4, 2), (2, 6, 0, 2), (4, 5, 4, 4), step=10)
    better = desk.executor.expect(Replacement)  # of look-ahead; not answered yet
    desk.executor.send(Begun(program.program, 0, 1))
    desk.executor.show(outputs=program.stages[0].states)
    states = np.array([unpack(better.stages[-1].states) >> k & 1 for k in range(desk.executor.actuators)])
    tip = desk.arm.manipulator.tip(desk.arm.manipulator.configuration(states))[:2, 3].tolist()
    desk.ask("obstacles", {"regions": [{"disc": {"centre": tip, "radius": 0.004}}]}, "obstacles")
    desk.executor.send(Replaced(program.program, better.generation, True))
    assert desk.executor.expect(Cancel).program == program.program
    assert desk.executor.nothing(Replacement)


def test_a_plan_query_is_answered_as_plans_are_made_elsewhere(
    desk: Desk, small_densities: Densities, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(whole, "WHOLE_TIME", 60.0)  # so that both prove the fewest switches on any machine
    positions = np.array([desk.tip(*row) for row in ((1, 2, 3, 4), (5, 6, 7, 0), (1, 2, 0, 0))])
    waypoints = [{"t": 10 * k, "position": position.tolist()} for k, position in enumerate(positions)]
    desk.ask("plan", {"waypoints": waypoints}, "plan")
    answer = desk.inbox.next("plan")
    goals = whole.TipGoals(positions, np.full(3, 0.002), np.tile(np.eye(3), (3, 1, 1)), np.full(3, np.inf))
    pace, solver = pace_of(desk.arm.settings), Solver(desk.arm.reduced, small_densities)
    planner = TransitionPlanner(solver, whole.unhurried(goals, pace), pace)
    plan = whole.plan_whole(planner, np.zeros(4, dtype=np.int64), "minimum-switch")
    assert answer["certificate"] == plan.certificate == "optimal"
    assert answer["switches"] == answer["lower_bound"] == plan.switches


@pytest.fixture
def joints(read: Callable[[Any], Arm], make_desk: Callable[..., Desk]) -> tuple[Desk, int]:
    """An arm of two joints, whose two actuators have one pair of states that is no configuration, and this pair."""
    desk = make_desk(read({**DOCUMENT, "modules": [JOINT]}))
    return desk, unused_states(desk.arm)


def test_a_state_that_is_no_configuration_is_left_by_single_actuators(joints: tuple[Desk, int]) -> None:
    desk, unused = joints
    goal = {"waypoints": [{"position": [0.2, 0.0]}]}
    desk.show(outputs=unused, moving=True, mode="executing", reason="jog jog-1")
    desk.ask("goal", goal)
    moves = "unknown state: the arm moves to states that are no configuration (jog jog-1)"
    assert desk.inbox.next("reply")["message"].startswith(moves)
    desk.show(moving=False, mode="ready", reason="holding")
    (fault,) = desk.state()["faults"]
    assert (fault["code"], desk.state()["mode"]) == ("unknown-state", "ready")
    desk.ask("goal", goal)
    assert desk.inbox.next("reply")["message"].startswith("unknown state: what the boards measure is no configuration")
    desk.ask("jog", {"actuators": dict.fromkeys(desk.arm.manipulator.actuators[:2], "contracted")})
    program = desk.executor.expect(Program)
    desk.executor.accept(program)
    assert desk.inbox.next("reply")["accepted"]
    desk.executor.run(program, 0)
    desk.executor.end(program)
    assert desk.inbox.next("result")["status"] == "succeeded"
    assert desk.state()["faults"] == []


def degrade(desk: Desk, actuator: int, state: int | None) -> None:
    desk.ask("degrade", {"actuator": desk.arm.manipulator.actuators[actuator], "state": state}, "degrade")


def test_a_locked_actuator_is_unlocked_in_a_state_that_is_no_configuration(joints: tuple[Desk, int]) -> None:
    desk, unused = joints
    desk.show(outputs=unused | unused << 2, locked=b"\x04")
    assert "unknown-state" in [fault["code"] for fault in desk.state()["faults"]]
    degrade(desk, 2, None)
    lock = desk.executor.expect(Lock)
    assert (lock.actuator, lock.state) == (2, -1)


@pytest.mark.parametrize(("sensed", "homing", "refused"), [(0b00, 0b00, True), (0b10, 0b00, False), (0b10, 0b10, True)])
def test_a_lock_that_leaves_a_module_no_state_is_refused_unless_an_end_stop_denies_it(
    joints: tuple[Desk, int], sensed: int, homing: int, refused: bool
) -> None:
    desk, unused = joints
    size, first, second = desk.executor.actuators, unused & 1, unused >> 1
    known = pack(0b1111 & ~homing, size)
    desk.show(outputs=first, sensed=pack(sensed, size), known=known, homing=pack(homing, size), locked=b"\x01")
    assert desk.state()["degraded"] == [{"actuator": desk.arm.manipulator.actuators[0], "state": first}]
    degrade(desk, 1, second)
    if refused:
        assert desk.inbox.next("degrade")["reason"] == "module-without-state"
        assert desk.executor.nothing(Lock)
    else:
        assert desk.executor.expect(Lock).actuator == 1


INSTEAD = "switches instead of 10: "


@pytest.mark.parametrize(
    ("planned", "improved", "switches", "homed", "sentence"),
    [
        (10, 10, 10, 0, ""),
        (None, None, 3, 0, ""),
        (10, 9, 9, 0, f"9 {INSTEAD}the plan was improved while the arm moved"),
        (10, None, 9, 0, f"9 {INSTEAD}the plan was improved while the arm moved"),
        (10, 10, 8, 0, f"8 {INSTEAD}stages that were late were joined"),
        (10, 10, 12, 0, f"12 {INSTEAD}actuators that were not in their expected states were switched, too"),
        (10, 10, 34, 24, "34 switches, 24 of them to home actuators of unknown position"),
        (10, 10, 9, 1, "9 switches instead of 11, 1 of them to home actuators: stages that were late were joined"),
    ],
)
def test_a_result_tells_why_its_switches_are_not_those_of_the_answer(
    planned: int | None, improved: int | None, switches: int, homed: int, sentence: str
) -> None:
    first, last = (None if n is None else PlanProof(n, float(n), 0.0, "unknown") for n in (planned, improved))
    assert why_not_as_planned(first, last, switches, homed) == sentence
