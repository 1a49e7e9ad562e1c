"""Locked actuators, single actuators, and states that are no configuration."""

from collections.abc import Callable
from typing import Any

import pytest

from hyperbit.controller.arm.arm import Arm
from hyperbit.controller.motion.decoding.goal import BEGIN_WITHIN
from hyperbit.controller.planning.core.tasks import BuildTables
from hyperbit.controller.program import Acknowledge, Answer, Lock, Program, Replacement, Travel, pack, unpack
from hyperbit.controller.refusals.reasons import Reason
from hyperbit.controller.refusals.refusal import Refused
from tests.planning.conftest import DOCUMENT
from tests.planning.rig.desk import Desk
from tests.planning.test_goals import A, B, C, taken
from tests.planning.test_obstacles import obstacles


def degrade(desk: Desk, actuator: str, state: int | None) -> None:
    desk.ask("degrade", {"actuator": actuator, "state": state}, "degrade")


def test_a_locked_actuator_is_planned_around(desk: Desk) -> None:
    degrade(desk, "1.left", 0)
    lock = desk.executor.expect(Lock)
    assert (lock.actuator, lock.state) == (0, 0)
    desk.executor.answer(lock, "locked, as the executor says", locked=b"\x01\x00", locks=1)
    words = "locked, as the executor says"  # its snapshot may come later
    assert desk.inbox.next("degrade") == {"accepted": True, "code": 0, "message": words}
    assert desk.state()["degraded"] == [{"actuator": "1.left", "state": 0}]
    assert [fault["code"] for fault in desk.state()["faults"]] == ["degraded"]
    assert desk.state()["mode"] == "ready"
    desk.goal((0, 1, 0, 0))
    program = desk.executor.expect(Program)
    assert not unpack(program.stages[-1].states) & 1


def test_while_the_tables_are_rebuilt_goals_wait(desk: Desk) -> None:
    desk.held.add(BuildTables)
    desk.show(locked=b"\x01\x00", locks=1)
    assert desk.state()["mode"] == "starting"
    assert desk.state()["reason"] == "the planner's tables are being rebuilt; locked: 1.left (contracted)"
    desk.goal((0, 1, 0, 0))
    assert desk.inbox.empty
    desk.release(BuildTables)
    assert desk.state()["mode"] == "ready"
    program = desk.executor.expect(Program)
    assert not unpack(program.stages[-1].states) & 1
    desk.executor.accept(program)
    assert desk.inbox.next("reply")["accepted"]


@pytest.mark.parametrize("passing", [{"moving": True}, {"known": b"\xfe\x0f"}])
def test_tables_are_rebuilt_once_the_locked_actuators_rest_in_known_states(desk: Desk, passing: dict[str, Any]) -> None:
    words = "locked: 1.left (contracted)"
    desk.show(locked=b"\x01\x00", locks=1, **passing)
    assert not [text for text in desk.logs if "locked" in text]
    desk.show(moving=False, known=b"\xff\x0f")
    assert [text for text in desk.logs if words in text]


def test_goals_do_not_wait_for_tables_for_ever(desk: Desk) -> None:
    desk.held.add(BuildTables)
    desk.show(locked=b"\x01\x00", locks=1)
    desk.goal(A)
    desk.pass_time(BEGIN_WITHIN)
    assert desk.inbox.next("reply")["message"].startswith("the arm is starting: the planner's tables are being rebuilt")


def test_a_stop_refuses_goals_that_wait_for_tables(desk: Desk) -> None:
    desk.held.add(BuildTables)
    desk.show(locked=b"\x01\x00", locks=1)
    desk.goal(A)
    desk.ask("stop")
    assert Reason.OVERTAKEN.value in [payload.get("reason") for _, payload in desk.inbox.payloads]


def test_tables_that_cannot_be_rebuilt_are_a_fault_until_reset(desk: Desk) -> None:
    desk.failing.add(BuildTables)
    desk.show(locked=b"\x01\x00", locks=1)
    assert desk.state()["mode"] == "fault"
    assert "no memory" in desk.state()["reason"]
    assert ("internal-error", "daemon") in [(fault["code"], fault["source"]) for fault in desk.state()["faults"]]
    desk.failing.clear()
    desk.ask("reset")
    assert desk.state()["mode"] == "ready"
    assert "internal-error" not in [fault["code"] for fault in desk.state()["faults"]]


def test_a_state_that_the_end_stop_denies_is_the_executors_to_refuse(desk: Desk) -> None:
    desk.show(sensed=desk.executor.state.known)
    degrade(desk, "1.left", 1)
    lock = desk.executor.expect(Lock)
    desk.executor.answer(lock, "the end-stop of 1.left reads contracted", accepted=False)
    assert desk.inbox.next("degrade")["message"] == "the end-stop of 1.left reads contracted"


def test_a_lock_of_an_unknown_actuator_is_refused_in_words(desk: Desk) -> None:
    degrade(desk, "9.left", 0)
    reply = desk.inbox.next("degrade")
    words = "actuator: '9.left' is no actuator of this arm; they are 1.left to 4.right"
    assert (reply["accepted"], reply["message"]) == (False, words)


def test_a_lock_that_the_executor_refuses_ends_nothing(desk: Desk) -> None:
    taken(desk, A, B, step=10)
    degrade(desk, "1.left", 0)
    lock = desk.executor.expect(Lock, Replacement)
    desk.executor.send(Answer(lock.request, "", Refused(Reason.LOCK_WHILE_MOVING, {"mode": "executing"})))
    reply = desk.inbox.next("degrade")
    assert (reply["accepted"], reply["reason"]) == (False, "lock-while-moving")
    assert reply["message"] == "the arm is executing, and may not move while locks change"
    desk.executor.show()
    desk.goal(C, name="c")
    assert desk.executor.expect(Program, Replacement).epoch == 1


def jog(desk: Desk, **actuators: str) -> None:
    named = {label.replace("_", ".").strip("m"): state for label, state in actuators.items()}
    desk.ask("jog", {"actuators": named})


def test_single_actuators_are_switched(desk: Desk) -> None:
    jog(desk, m1_left="extended", m2_right="extended")
    program = desk.executor.expect(Program)
    assert [unpack(stage.states) for stage in program.stages] == [0b100001]
    desk.executor.accept(program)
    reply = desk.inbox.next("reply")
    assert (reply["accepted"], reply["message"]) == (True, "accepted, 2 switches: 1.left extended, 2.right extended")
    desk.executor.run(program, 0)
    desk.executor.end(program, travels=(Travel(5, 1, 0.0625),))
    result = desk.inbox.next("result")
    assert (result["id"], result["status"], result["message"]) == (reply["id"], "succeeded", "switched")
    assert result["travels"] == [{"actuator": "2.right", "state": "extended", "seconds": 0.0625}]
    jog(desk, m1_left="contracted")
    program = desk.executor.expect(Program, Acknowledge)
    desk.executor.accept(program)
    reply = desk.inbox.next("reply")
    desk.executor.end(program)
    assert desk.inbox.next("result")["message"] == "not measured in the requested state: 1.left"


def test_locked_actuators_and_those_that_would_touch_are_not_switched(desk: Desk) -> None:
    desk.show(locked=b"\x01\x00", locks=1)
    jog(desk, m1_left="extended")
    assert desk.inbox.next("reply")["reason"] in ("actuator-locked", "arm-starting")
    assert desk.state()["mode"] == "ready"
    obstacles(desk, (desk.tip(0, 0, 0, 1), 0.02))
    jog(desk, m4_left="extended")
    assert desk.inbox.next("reply")["reason"] == "start-collides"
    jog(desk, m4_middle="extended")
    assert "'4.middle' is no actuator of this arm" in desk.inbox.next("reply")["message"]


JOINT = {"type": "transforms", "states": [{"position": [0.1, 0.05 * k]} for k in range(3)], "count": 2}


def test_a_state_that_is_no_configuration_is_left_by_single_actuators(
    read: Callable[[Any], Arm], make_desk: Callable[..., Desk]
) -> None:
    desk = make_desk(read({**DOCUMENT, "modules": [JOINT]}))
    unused = next(
        bits for bits in range(4) if bits not in {int(row @ [1, 2]) for row in desk.arm.manipulator.modules[0].bits}
    )
    desk.show(outputs=unused)
    (fault,) = desk.state()["faults"]
    assert (fault["code"], desk.state()["mode"]) == ("unknown-state", "ready")
    desk.ask("goal", {"waypoints": [{"position": [0.2, 0.0]}]})
    assert desk.inbox.next("reply")["message"].startswith("unknown state: what the boards measure is no configuration")
    labels = desk.arm.manipulator.actuators
    wanted = {label: "contracted" for label in labels[:2]}
    desk.ask("jog", {"actuators": wanted})
    program = desk.executor.expect(Program)
    desk.executor.accept(program)
    assert desk.inbox.next("reply")["accepted"]
    desk.executor.run(program, 0)
    desk.executor.end(program)
    assert desk.inbox.next("result")["status"] == "succeeded"
    desk.settle()
    assert desk.state()["faults"] == []


@pytest.fixture
def joints(read: Callable[[Any], Arm], make_desk: Callable[..., Desk]) -> tuple[Desk, int]:
    """An arm of two joints, whose two actuators have one pair of states that is no configuration, and this pair."""
    desk = make_desk(read({**DOCUMENT, "modules": [JOINT]}))
    used = {int(row @ [1, 2]) for row in desk.arm.manipulator.modules[0].bits}
    return desk, next(bits for bits in range(4) if bits not in used)


def test_a_locked_actuator_is_unlocked_in_a_state_that_is_no_configuration(joints: tuple[Desk, int]) -> None:
    desk, unused = joints
    desk.show(outputs=unused | unused << 2, locked=b"\x04", locks=1)
    assert "unknown-state" in [fault["code"] for fault in desk.state()["faults"]]
    degrade(desk, desk.arm.manipulator.actuators[2], None)
    lock = desk.executor.expect(Lock)
    assert (lock.actuator, lock.state) == (2, -1)


@pytest.mark.parametrize(("sensed", "homing", "refused"), [(0b00, 0b00, True), (0b10, 0b00, False), (0b10, 0b10, True)])
def test_a_lock_that_leaves_a_module_no_state_is_refused_unless_an_end_stop_denies_it(
    joints: tuple[Desk, int], sensed: int, homing: int, refused: bool
) -> None:
    desk, unused = joints
    size, first, second = desk.executor.actuators, unused & 1, unused >> 1
    known = pack(0b1111 & ~homing, size)
    desk.show(outputs=first, sensed=pack(sensed, size), known=known, homing=pack(homing, size), locked=b"\x01", locks=1)
    label, other = desk.arm.manipulator.actuators[:2]
    assert desk.state()["degraded"] == [{"actuator": label, "state": first}]
    degrade(desk, other, second)
    if refused:
        assert desk.inbox.next("degrade")["reason"] == "module-without-state"
        assert desk.executor.nothing(Lock)
    else:
        assert desk.executor.expect(Lock).actuator == 1


def test_a_goal_during_a_jog_to_a_state_that_is_no_configuration_is_refused_with_this_cause(
    joints: tuple[Desk, int],
) -> None:
    desk, unused = joints
    desk.show(outputs=unused, moving=True, mode="executing", reason="jog jog-1")
    desk.ask("goal", {"waypoints": [{"position": [0.2, 0.0]}]})
    message = desk.inbox.next("reply")["message"]
    assert message.startswith("unknown state: the arm moves to states that are no configuration (jog jog-1)")


def test_actuators_of_unknown_state_are_planned_from_a_guess_and_a_jog_homes_only_its_own(desk: Desk) -> None:
    unknown = pack(0b000011, desk.executor.actuators)
    known = pack(((1 << desk.executor.actuators) - 1) & ~0b000011, desk.executor.actuators)
    desk.show(known=known, homing=unknown)
    desk.goal(C, name="c")
    program = desk.executor.expect(Program)
    assert (program.start, program.homed) == (desk.executor.state.outputs, b"")
    desk.executor.accept(program)
    assert desk.inbox.next("reply")["accepted"]
    desk.executor.end(program, "aborted")
    desk.inbox.next("result")
    jog(desk, m1_left="contracted")
    program = desk.executor.expect(Program, Acknowledge)
    assert unpack(program.homed) == 1


def test_state_plan_and_answer_tell_what_a_goal_homes_and_the_result_counts_it(desk: Desk) -> None:
    count = desk.executor.actuators
    desk.show(known=pack(((1 << count) - 1) & ~0b11, count), homing=pack(0b11, count))
    homing = list(desk.arm.manipulator.actuators[:2])
    assert desk.published["state"]["homing"] == homing
    desk.ask("plan", {"waypoints": [{"position": desk.tip(*C)}]}, "plan")
    told = f"; before them 2 switches home actuators of unknown position: {', '.join(homing)}"
    plan = desk.inbox.next("plan")
    assert (plan["homing"], plan["message"].endswith(told)) == (homing, True)
    desk.goal(C, name="c")
    program = desk.executor.expect(Program)
    planned = (unpack(program.start) ^ unpack(program.stages[-1].states)).bit_count()
    desk.executor.accept(program)
    answer = desk.inbox.next("reply")
    assert (answer["homing"], answer["message"]) == (homing, f"accepted, 1 waypoint, {planned} switches planned{told}")
    desk.show(known=pack((1 << count) - 1, count), homing=pack(0, count))
    desk.executor.run(program, 0, switches=planned + 2)
    desk.inbox.next("feedback")
    desk.executor.end(program, switches=planned + 2)
    result = desk.inbox.next("result")
    told = f"reached; {planned + 2} switches, 2 of them to home actuators of unknown position"
    assert (result["message"], result["planned_switches"]) == (told, planned)


def test_the_answer_to_a_goal_says_that_its_homing_is_not_checked_among_obstacles(desk: Desk) -> None:
    count = desk.executor.actuators
    desk.show(known=pack(((1 << count) - 1) & ~1, count), homing=pack(1, count))
    obstacles(desk, ([5.0, 5.0], 0.1))
    desk.goal(C, name="c")
    desk.executor.accept(desk.executor.expect(Program))
    told = desk.inbox.next("reply")
    assert told["accepted"]
    assert told["message"].endswith(
        "collisions of the homing were not checked, because it is not known where 1.left is"
    )
