"""Results: one for each accepted goal, whichever process is killed between any two steps."""

from collections.abc import Callable
from typing import Any

import pytest

from hyperbit.controller.motion.stages.feed import PlanProof
from hyperbit.controller.planning.core.events import AcceptanceEntry, Identity, ResultEntry
from hyperbit.controller.planning.core.results import why_not_as_planned
from hyperbit.controller.program import Acknowledge, Cancel, Program, Replacement
from hyperbit.controller.workspace.densities import Densities
from tests.planning.rig.desk import Desk
from tests.planning.test_goals import A, B, C, taken

Make = Callable[..., Desk]
REACHED = ResultEntry(0.0, "succeeded", 0, "reached", 4)


@pytest.fixture
def make(make_desk: Make, desk: Desk, small_densities: Densities) -> Make:
    """Builds a further planner process of the same arm."""
    return lambda **more: make_desk(desk.arm, small_densities, **more)


def kinds(desk: Desk) -> list[str]:
    return [kind for kind, _ in desk.entries]


def test_a_goal_is_answered_after_the_ledger_has_it(desk: Desk) -> None:
    desk.storing = False
    desk.goal(A)
    desk.executor.accept(desk.executor.expect(Program))
    assert desk.inbox.empty
    desk.store()
    assert desk.inbox.next("reply")["accepted"]


def test_a_goal_that_ends_before_the_ledger_has_it_is_answered_and_ended_when_the_ledger_has_it(desk: Desk) -> None:
    desk.storing = False
    desk.goal(A)
    desk.executor.accept(program := desk.executor.expect(Program))
    ended = desk.executor.end(program)
    assert desk.inbox.empty, "after a kill of both processes nobody would know the goal"
    desk.store()  # the acceptance
    assert desk.inbox.next("reply")["accepted"]
    assert desk.inbox.next("result")["id"] == "a"
    desk.store()  # published
    desk.store()  # recorded
    assert desk.inbox.empty, "the goal is answered once"
    assert desk.executor.expect(Acknowledge, Replacement).result == ended.result


def test_a_goal_whose_executor_dies_before_the_ledger_has_it_ends_when_the_ledger_has_it(desk: Desk) -> None:
    desk.storing = False
    desk.goal(A)
    desk.executor.accept(desk.executor.expect(Program))
    desk.drop()
    assert desk.inbox.empty
    desk.store()
    assert desk.inbox.next("reply")["accepted"]
    assert desk.inbox.next("result")["status"] == "aborted"


def test_a_result_is_acknowledged_after_it_was_published_and_recorded(desk: Desk) -> None:
    program = taken(desk, A)
    desk.storing = False
    ended = desk.executor.end(program)
    assert desk.inbox.next("result")["id"] == "a"
    assert desk.executor.nothing(Acknowledge)
    assert kinds(desk) == ["accepted"]
    desk.store()  # published
    assert desk.executor.nothing(Acknowledge)
    desk.store()  # recorded
    assert kinds(desk) == ["accepted", "accepted+ended"]
    assert desk.executor.expect(Acknowledge, Replacement).result == ended.result


def test_a_result_that_comes_again_on_its_way_is_published_once(desk: Desk) -> None:
    program = taken(desk, A)
    desk.storing = False
    ended = desk.executor.end(program)
    desk.drop()
    desk.executor.greet(program.program)
    desk.executor.send(ended)
    assert desk.inbox.next("result")["id"] == "a"
    desk.store()
    desk.store()
    assert desk.inbox.empty
    assert desk.executor.expect(Acknowledge, Replacement).result == ended.result


def test_what_an_earlier_process_has_published_and_recorded_is_acknowledged_only(desk: Desk, make: Make) -> None:
    program = taken(desk, A)
    later = make(published={Identity(1, program.program): REACHED})
    ended = later.executor.end(program)
    assert later.inbox.empty
    assert kinds(later) == ["accepted+ended"]
    assert later.executor.expect(Acknowledge).result == ended.result


def test_what_another_executor_owed_is_lost(make: Make) -> None:
    owed = {Identity(77, 5): AcceptanceEntry("old", 12.0, 3)}
    later = make(owed=owed)
    result = later.inbox.next("inherited")
    assert (result["id"], result["status"], result["code"]) == ("old", "lost", -4)
    assert "the executor ended before it told" in result["message"]
    ((kind, entry),) = later.entries
    assert (kind, entry.identity, entry.ended.status) == ("accepted+ended", Identity(77, 5), "lost")
    later.drop()
    later.executor.greet()
    assert later.inbox.empty


def test_what_the_same_executor_owes_is_waited_for(desk: Desk, make: Make) -> None:
    program = taken(desk, A)
    later = make(owed={Identity(1, program.program): AcceptanceEntry("a", 12.0, 1)})
    assert later.inbox.empty
    later.executor.end(program, "aborted", "the planner is gone", mark=-1)
    assert later.inbox.next("inherited")["message"] == "the planner is gone"
    later.drop()
    later.executor.instance = 2
    later.executor.greet()
    assert later.inbox.empty


def test_what_an_earlier_process_may_have_published_in_vain_is_repeated_with_the_same_outcome(
    desk: Desk, make: Make
) -> None:
    program, own = taken(desk, A), ResultEntry(0.0, "aborted", -4, "the planned motion would collide", 3)
    identity = Identity(1, program.program)
    later = make(owed={identity: AcceptanceEntry("a", 12.0, 1)}, published={identity: own})
    ended = later.executor.end(program, "canceled", "canceled", switches=3)
    result = later.inbox.next("inherited")
    assert result["repeated"]
    assert (result["status"], result["code"], result["message"], result["switches"]) == own[1:]
    assert later.executor.expect(Acknowledge).result == ended.result
    later.executor.send(ended)
    assert later.inbox.empty


def test_what_another_executor_owed_is_repeated_as_it_was_published(make: Make) -> None:
    owed = {Identity(77, 5): AcceptanceEntry("old", 12.0, 3)}
    later = make(owed=owed, published={Identity(77, 5): REACHED})
    result = later.inbox.next("inherited")
    assert result["repeated"]
    assert (result["id"], result["status"], result["message"], result["switches"]) == ("old", "succeeded", "reached", 4)
    assert kinds(later) == ["accepted+ended"]


def test_a_result_is_not_repeated_if_no_process_has_published_it(desk: Desk, make: Make) -> None:
    program = taken(desk, A)
    later = make(owed={Identity(1, program.program): AcceptanceEntry("a", 12.0, 1)})
    later.executor.end(program)
    assert "repeated" not in later.inbox.next("inherited")


def test_a_goal_that_was_refused_gets_no_result(desk: Desk) -> None:
    desk.goal(A)
    program = desk.executor.expect(Program)
    desk.drop()
    assert desk.inbox.next("reply")["reason"] == "executor-lost"
    desk.executor.greet(program.program)
    ended = desk.executor.end(program, "aborted", "the planner is gone", mark=-1)
    assert desk.inbox.empty
    assert desk.executor.expect(Acknowledge).result == ended.result


def test_an_inherited_jog_is_judged_by_the_measured_states(desk: Desk, make: Make) -> None:
    desk.ask("jog", {"actuators": {"1.left": "extended"}})
    program = desk.executor.expect(Program)
    later = make()
    later.executor.end(program)  # done, but the actuator is measured contracted
    result = later.inbox.next("inherited")
    assert (result["status"], result["message"]) == ("aborted", "not measured in the requested state: 1.left")


@pytest.mark.parametrize("context", [b"", b"\xc1", b"\x81\xa2id\x01"])
def test_a_context_of_another_version_is_logged_and_acknowledged(desk: Desk, context: bytes) -> None:
    program = taken(desk, A)
    ended = desk.executor.end(Program(9, 1, bytes(2), 0.0, program.stages, True, False, "goal z", context))
    assert desk.executor.expect(Acknowledge, Replacement).result == ended.result
    assert "has no context that this planner can decode" in desk.logs[-1]


def test_a_certificate_stands_only_beside_the_switches_that_it_speaks_of(desk: Desk) -> None:
    program = taken(desk, A)
    desk.executor.run(program, 0)
    desk.inbox.next("feedback")
    desk.executor.end(program, switches=8)
    result = desk.inbox.next("result")
    assert (result["switches"], result["certificate"], result["optimal"], result["lower_bound"]) == (
        8,
        "unknown",
        None,
        None,
    )


def cancel(desk: Desk, **payload: Any) -> dict[str, Any]:
    desk.ask("cancel", payload, "canceled")
    return desk.inbox.next("canceled")


def test_a_cancel_of_a_goal_cancels_that_one_only(desk: Desk) -> None:
    program = taken(desk, A, B, step=10)
    assert cancel(desk, id="other")["message"] == "goal other is not running"
    assert desk.executor.nothing(Cancel)
    desk.ask("cancel", {"id": "a"}, "canceled")
    message = desk.executor.expect(Cancel, Replacement)
    assert message.program == program.program
    desk.executor.answer(message, "canceled")
    assert desk.inbox.next("canceled")["message"] == "canceled"


def test_a_cancel_of_a_waiting_goal_lets_the_running_one_go_on(desk: Desk) -> None:
    desk.goal(A)
    program = desk.executor.expect(Program)
    desk.goal(C, name="c")
    desk.ask("cancel", {"id": "c"}, "canceled")
    assert not desk.inbox.next("reply")["accepted"]
    assert desk.inbox.next("canceled")["accepted"]
    desk.executor.accept(program)
    assert desk.inbox.next("reply")["accepted"]


@pytest.mark.parametrize(
    ("planned", "improved", "switches", "homed", "sentence"),
    [
        (10, 10, 10, 0, ""),
        (None, None, 3, 0, ""),
        (10, 9, 9, 0, "9 switches instead of 10: the plan was improved while the arm moved"),
        (10, None, 9, 0, "9 switches instead of 10: the plan was improved while the arm moved"),
        (10, 10, 8, 0, "8 switches instead of 10: stages that were late were joined"),
        (
            10,
            10,
            12,
            0,
            "12 switches instead of 10: actuators that were not in their expected states were switched, too",
        ),
        (10, 10, 34, 24, "34 switches, 24 of them to home actuators of unknown position"),
        (10, 10, 9, 1, "9 switches instead of 11, 1 of them to home actuators: stages that were late were joined"),
    ],
)
def test_a_result_tells_why_its_switches_are_not_those_of_the_answer(
    planned: int | None, improved: int | None, switches: int, homed: int, sentence: str
) -> None:
    first, last = (None if n is None else PlanProof(n, float(n), 0.0, "unknown") for n in (planned, improved))
    assert why_not_as_planned(first, last, switches, homed) == sentence
