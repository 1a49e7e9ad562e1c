"""The order of requests: a stop or cancel bars all that arrived before it, on whatever way that comes to the core."""

from __future__ import annotations

import pytest

from hyperbit.controller.planning.core.events import Arrival, CancelMessage, Request, Unsent
from hyperbit.controller.planning.core.parts import Admission
from hyperbit.controller.planning.core.tasks import PlanGoal
from hyperbit.controller.program import Cancel, Program, Reset, pack
from hyperbit.controller.refusals.reasons import Reason
from tests.planning.rig.desk import Desk
from tests.planning.test_goals import A, B


def replies(desk: Desk, key: str = "reply") -> list[str | None]:
    return [payload.get("reason") for came, payload in desk.inbox.payloads if came == key]


def test_a_reset_carries_the_epoch_of_its_arrival(desk: Desk) -> None:
    desk.show(mode="stopped", epoch=7)
    desk.ask("reset")
    assert desk.executor.expect(Reset).epoch == 7


def test_a_reset_that_follows_a_stop_waits_for_the_epoch_of_the_stop(desk: Desk) -> None:
    desk.ask("stop", name="stop")
    desk.ask("reset", name="reset")
    stop = desk.executor.messages.popleft()
    assert desk.executor.nothing(Reset)
    desk.executor.answer(stop, "stopped", mode="stopped")
    reset = desk.executor.expect(Reset)
    assert reset.epoch == desk.executor.state.epoch
    desk.executor.answer(reset, "resetting")
    assert desk.inbox.next("stop")["accepted"]
    assert desk.inbox.next("reset")["accepted"]


def test_a_stop_ends_a_reset_that_waits_before_it(desk: Desk) -> None:
    desk.ask("stop", name="stop")
    desk.ask("reset", name="reset")
    desk.ask("stop", name="stop")
    assert replies(desk, "reset") == ["overtaken"]
    assert desk.executor.nothing(Reset)


def test_a_reset_without_an_answer_of_the_executor_is_refused(desk: Desk) -> None:
    desk.ask("cancel", name="cancel")
    desk.ask("reset", name="reset")
    desk.pass_time(2.5)
    assert desk.failures  # the executor is silent
    assert desk.executor.nothing(Reset)
    desk.drop()
    assert replies(desk, "reset") == ["executor-behind"]


def test_a_goal_without_an_executor_is_refused_because_there_is_none(desk: Desk) -> None:
    desk.drop()
    desk.ask("stop", name="stop")
    desk.ask("goal", {"waypoints": [{"position": [0.2, 0.0]}]}, name="goal")
    desk.pass_time(3.0)
    assert replies(desk, "goal") == ["arm-in-fault"]


def test_a_stop_that_could_not_be_sent_is_refused(desk: Desk) -> None:
    number = desk.ask("stop", name="stop")
    desk.post(Unsent(number, "the executor's socket is full"))
    answer = desk.inbox.next("stop")
    assert (answer["reason"], "the executor's socket is full" in answer["message"]) == ("no-executor", True)


def test_the_loss_of_the_executor_bars_all_that_arrived_before() -> None:
    admission = Admission()
    early = admission.arrive(4)
    admission.lost()
    late = admission.arrive(5)
    assert [admission.barred(ticket) for ticket in (early, late)] == [True, False]


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
    desk.names[0] = "reply"
    desk.post(Request(Arrival(number - 1, desk.now), "goal", late, desk.wall)) if number > 1 else None
    desk.release(PlanGoal)
    desk.pass_time(1.0)
    assert {program.name for program in desk.executor.messages if isinstance(program, Program)} <= {"goal b"}


def test_a_goal_that_is_sent_after_its_cancel_runs(desk: Desk) -> None:
    desk.ask("cancel", {"id": "a"}, name="cancel")
    assert "not running" in desk.inbox.next("cancel")["message"]
    desk.goal(A, name="a")
    assert desk.executor.expect(Program).name == "goal a"


def test_cancels_of_many_ids_are_forgotten(desk: Desk) -> None:
    for number in range(1, 2_000):
        desk.names[number] = "cancel"
        desk.post(Request(Arrival(number, desk.now), "cancel", CancelMessage(f"g{number}"), desk.wall))
    assert len(desk.core.admission.canceled) < 300


def test_without_an_executor_streams_leave_nothing(make_desk, small_densities, desk: Desk) -> None:  # type: ignore[no-untyped-def]
    alone = make_desk(desk.arm, small_densities)
    alone.drop()
    for number in range(1, 3_000):
        alone.setpoint(b'{"position": [9.0, 9.0]}' if number % 2 else b"{", number)
        alone.now += 0.3 * (number % 10 == 0)
    assert len(alone.core.admission.unresolved) < 300


def test_a_jog_says_if_it_is_not_known_where_the_arm_is(desk: Desk) -> None:
    actuators = desk.executor.actuators
    desk.ask("obstacles", {"regions": [{"disc": {"centre": [9.0, 9.0], "radius": 0.1}}]}, name="obstacles")
    desk.show(known=pack((1 << actuators) - 2, actuators), homing=pack(1, actuators))
    desk.ask("jog", {"actuators": {"4.right": "extended"}})
    program = desk.executor.expect(Program)
    assert not program.strict
    desk.executor.accept(program)
    assert desk.inbox.next("obstacles")["accepted"]
    assert desk.inbox.next("reply")["message"].endswith("not checked, because it is not known where 1.left is")
