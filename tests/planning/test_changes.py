"""Obstacles, locks, single actuators, states that are no configuration, and set-points, on a played executor."""

import json
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from controller.config import Arm
from controller.motion import codes
from controller.program import (
    Acknowledge,
    Answer,
    Cancel,
    Clearance,
    Lock,
    Program,
    Question,
    Replaced,
    Replacement,
    Setpoint,
    unpack,
)
from tests.planning.conftest import DOCUMENT, Desk
from tests.planning.executor import Inbox
from tests.planning.test_goals import A, B, C, taken
from tests.waiting import eventually

HOME = (0, 0, 0, 0)


def obstacles(desk: Desk, *discs: tuple[list[float], float]) -> dict[str, Any]:
    regions = [
        {"disc": {"centre": centre, "radius": radius}, "name": f"d{k}"} for k, (centre, radius) in enumerate(discs)
    ]
    desk.planning.obstacles(json.dumps({"regions": regions}).encode(), desk.inbox.replying("obstacles"))
    return desk.inbox.next("obstacles")


# --- obstacles


def test_obstacles_are_counted_and_the_same_again_changes_nothing(desk: Desk) -> None:
    assert obstacles(desk, ([5, 5], 0.1))["message"] == "keeping out of 1 region, 1 of them sent"
    generation = desk.planning._keep_out.current.generation
    assert obstacles(desk, ([5, 5], 0.1))["accepted"]
    assert desk.planning._keep_out.current.generation == generation
    assert obstacles(desk)["message"] == "keeping out of 0 regions, 0 of them sent"
    assert desk.planning._keep_out.current.generation == generation + 1


def test_as_many_obstacles_fit_as_may_be_sent(desk: Desk) -> None:
    reply = obstacles(desk, *[([5.123456789 + k, 5.987654321], 0.123456789) for k in range(256)])
    assert reply["message"] == "keeping out of 256 regions, 256 of them sent"
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


# --- locks


def degrade(desk: Desk, actuator: str, state: int | None) -> None:
    desk.planning.degrade(json.dumps({"actuator": actuator, "state": state}).encode(), desk.inbox.replying("degrade"))


def test_a_locked_actuator_is_planned_around(desk: Desk) -> None:
    degrade(desk, "1.left", 0)
    lock = desk.executor.expect(Lock)
    assert (lock.actuator, lock.state) == (0, 0)
    desk.executor.answer(lock, "locked", locked=b"\x01\x00", locks=1)
    assert desk.inbox.next("degrade") == {"accepted": True, "code": 0, "message": "held: 1.left (contracted)"}
    eventually(lambda: desk.planning.state()["degraded"])
    assert desk.planning.state()["degraded"] == [{"actuator": "1.left", "state": 0}]
    assert [fault["code"] for fault in desk.planning.state()["faults"]] == ["degraded"]
    eventually(lambda: desk.planning.state()["mode"] == "ready")
    desk.goal((0, 1, 0, 0))
    program = desk.executor.expect(Program)
    assert not unpack(program.stages[-1].states) & 1


def test_while_the_tables_are_rebuilt_goals_are_refused(desk: Desk, monkeypatch: pytest.MonkeyPatch) -> None:
    import threading

    door = threading.Event()
    rebuild = desk.planning._locked._rebuild
    monkeypatch.setattr(desk.planning._locked, "_rebuild", lambda held: (door.wait(30), rebuild(held)))
    desk.show(locked=b"\x01\x00", locks=1)
    eventually(lambda: desk.planning.state()["mode"] == "starting")
    assert desk.planning.state()["reason"] == "planning is made ready to go on, held: 1.left (contracted)"
    desk.goal(A)
    assert desk.inbox.next("reply")["message"].startswith("the arm is starting: planning is made ready to go on")
    door.set()
    eventually(lambda: desk.planning.state()["mode"] == "ready")


def test_tables_that_cannot_be_rebuilt_are_a_fault_until_reset(desk: Desk, monkeypatch: pytest.MonkeyPatch) -> None:
    rebuild = desk.planning._locked._rebuild

    def broken(held: Any) -> None:
        raise MemoryError("no memory")

    monkeypatch.setattr(desk.planning._locked, "_rebuild", broken)
    desk.show(locked=b"\x01\x00", locks=1)
    eventually(lambda: desk.planning.state()["mode"] == "fault")
    assert "no memory" in desk.planning.state()["reason"]
    monkeypatch.setattr(desk.planning._locked, "_rebuild", rebuild)
    desk.planning.reset(desk.inbox.replying("reset"))
    eventually(lambda: desk.planning.state()["mode"] == "ready")


@pytest.mark.parametrize(
    ("actuator", "state", "words"),
    [
        ("9.left", 0, "actuator: '9.left' is none of this arm's, which are 1.left to 4.right"),
        ("1.left", 1, "state: the end-stop of 1.left reads contracted"),
    ],
)
def test_a_lock_that_cannot_be_is_refused_in_words(desk: Desk, actuator: str, state: int, words: str) -> None:
    degrade(desk, actuator, state)
    reply = desk.inbox.next("degrade")
    assert (reply["accepted"], reply["message"]) == (False, words)


def test_a_lock_that_the_executor_refuses_ends_nothing(desk: Desk) -> None:
    taken(desk, A, B, step=10)
    degrade(desk, "1.left", 0)
    lock = desk.executor.expect(Lock, Replacement)
    desk.executor.send(Answer(lock.request, False, "the arm is executing"))
    assert desk.inbox.next("degrade")["message"] == "the arm is executing"
    desk.executor.show()
    desk.goal(C, name="c")
    assert desk.executor.expect(Program, Replacement).epoch == 1


# --- single actuators


def jog(desk: Desk, **actuators: str) -> None:
    named = {label.replace("_", ".").strip("m"): state for label, state in actuators.items()}
    desk.planning.jog(json.dumps({"actuators": named}).encode(), desk.inbox.replying())


def test_single_actuators_are_switched(desk: Desk) -> None:
    jog(desk, m1_left="extended", m2_right="extended")
    program = desk.executor.expect(Program)
    assert [unpack(stage.states) for stage in program.stages] == [0b100001]
    desk.executor.accept(program)
    reply = desk.inbox.next("reply")
    assert (reply["accepted"], reply["message"]) == (True, "accepted, 2 switches: 1.left extended, 2.right extended")
    desk.executor.run(program, 0)
    desk.executor.end(program)
    result = desk.inbox.next("result")
    assert (result["id"], result["status"], result["message"]) == (reply["id"], "succeeded", "switched")
    jog(desk, m1_left="contracted")
    program = desk.executor.expect(Program, Acknowledge)
    desk.executor.accept(program)
    reply = desk.inbox.next("reply")
    desk.executor.end(program)
    assert desk.inbox.next("result")["message"] == "not measured where they were sent: 1.left"


def test_locked_actuators_and_those_that_would_touch_are_not_switched(desk: Desk) -> None:
    desk.show(locked=b"\x01\x00", locks=1)
    jog(desk, m1_left="extended")
    message = desk.inbox.next("reply")["message"]
    assert "1.left is held" in message or message.startswith("the arm is starting")
    eventually(lambda: desk.planning.state()["mode"] == "ready")
    obstacles(desk, (desk.tip(0, 0, 0, 1), 0.02))
    jog(desk, m4_left="extended")
    assert "on the way from where the arm is" in desk.inbox.next("reply")["message"]
    jog(desk, m4_middle="extended")
    assert "'4.middle' is none of this arm's" in desk.inbox.next("reply")["message"]


JOINT = {"type": "transforms", "states": [{"position": [0.1, 0.05 * k]} for k in range(3)], "count": 2}


def test_a_state_that_is_no_configuration_is_left_by_single_actuators(
    read: Callable[[Any], Arm], make_desk: Callable[..., Desk]
) -> None:
    desk = make_desk(read({**DOCUMENT, "modules": [JOINT]}))
    unused = next(
        bits for bits in range(4) if bits not in {int(row @ [1, 2]) for row in desk.arm.manipulator.modules[0].bits}
    )
    desk.show(outputs=unused)
    (fault,) = desk.planning.state()["faults"]
    assert (fault["code"], desk.planning.state()["mode"]) == ("unknown-state", "ready")
    desk.raw({"waypoints": [{"position": [0.2, 0.0]}]})
    assert desk.inbox.next("reply")["message"].startswith("unknown state: what the boards measure is no configuration")
    labels = desk.arm.manipulator.actuators
    wanted = {label: "contracted" for label in labels[:2]}
    desk.planning.jog(json.dumps({"actuators": wanted}).encode(), desk.inbox.replying())
    program = desk.executor.expect(Program)
    desk.executor.accept(program)
    assert desk.inbox.next("reply")["accepted"]
    desk.executor.run(program, 0)
    desk.executor.end(program)
    assert desk.inbox.next("result")["status"] == "succeeded"
    desk.settle()
    assert desk.planning.state()["faults"] == []


# --- set-points


class Stream:
    """A mailbox of set-points of one goal, 50 a second, while the test waits."""

    def __init__(self, desk: Desk, position: list[float]) -> None:
        self.position: list[float] | None = position
        self.tolerance = 0.01
        desk.planning.setpoints(self.receive)

    def receive(self) -> bytes | None:
        if self.position is None:
            return None
        payload = {"position": self.position, "tolerance": {"position": self.tolerance}}
        return json.dumps(payload).encode()


def moving(desk: Desk) -> Setpoint:
    """Returns the next command of a stream that switches something."""
    while not (command := desk.executor.expect(Setpoint)).stages:
        pass
    return command


def test_setpoints_are_followed_from_the_latest_outputs(desk: Desk) -> None:
    stream = Stream(desk, desk.tip(*A))
    command = moving(desk)
    assert (command.start, command.epoch, command.strict) == (bytes(2), 1, False)
    assert command.reason == "following a setpoint"
    reached = command.stages[-1]
    states = np.array([unpack(reached) >> k & 1 for k in range(12)])
    tip = desk.arm.manipulator.tip(desk.arm.manipulator.configuration(states))[:2, 3]
    assert np.linalg.norm(tip - desk.tip(*A)) <= 0.01
    desk.show(outputs=reached, mode="executing", reason=command.reason, stream=command.stream)
    stream.position = None


def test_a_cancel_ends_the_stream_until_it_pauses(desk: Desk) -> None:
    stream = Stream(desk, desk.tip(*A))
    first = moving(desk)
    desk.planning.cancel(desk.inbox.replying("canceled"))
    cancel = desk.executor.expect(Cancel, Setpoint)
    desk.executor.answer(cancel, "canceled")
    assert desk.inbox.next("canceled")["accepted"]
    eventually(lambda: not desk.planning.diagnostics()["setpoint"]["alive"])
    received = desk.planning.diagnostics()["setpoint"]["received"]
    eventually(lambda: desk.planning.diagnostics()["setpoint"]["received"] > received + 20)
    assert desk.executor.nothing(Setpoint)
    stream.position = None
    eventually(lambda: desk.planning.diagnostics()["setpoint"]["rate"] == 0)
    stream.position = desk.tip(*A)
    command = desk.executor.expect(Setpoint)
    assert (command.stream > first.stream, command.epoch) == (True, 2)
    stream.position = None


def test_a_goal_ends_the_stream_before_it(desk: Desk) -> None:
    stream = Stream(desk, desk.tip(*A))
    moving(desk)
    desk.goal(C)
    program = desk.executor.expect(Program, Setpoint)
    desk.executor.accept(program)
    assert desk.inbox.next("reply")["accepted"]
    eventually(lambda: not desk.planning.diagnostics()["setpoint"]["alive"])
    stream.position = None
    late = [message for message in list(desk.executor._messages.queue) if isinstance(message, Setpoint)]
    assert all(message.stream < program.program for message in late), "the executor follows none of these"


def test_a_setpoint_out_of_reach_says_so(desk: Desk) -> None:
    stream = Stream(desk, [5.0, 5.0])
    while "out of reach at (5.0000, 5.0000)" not in (command := desk.executor.expect(Setpoint)).reason:
        pass
    assert command.stages == ()
    stream.position = None


# --- reports


def test_state_and_diagnostics_tell_what_they_did(desk: Desk) -> None:
    state = desk.planning.state()
    assert (state["mode"], state["reason"], state["configuration"]) == ("ready", "holding", "0000")
    assert (state["commanded"], state["measured"], state["goal"]) == ([0] * 12, [0] * 12, None)
    assert (state["waypoint"], state["faults"], state["degraded"]) == (None, [], [])
    assert state["tip"]["position"] == pytest.approx(desk.tip(*HOME))
    told = desk.planning.diagnostics()
    keys = {"stamp", "loop", "buses", "boards", "queues", "setpoint", "switches", "waits", "ledger", "real_time"}
    assert keys <= told.keys()
    assert (told["ledger"], told["queues"]) == ("ok", {"inbox": 0, "planning": 0})
    assert desk.planning.description()["name"] == "small"


def test_a_lost_executor_is_told(desk: Desk) -> None:
    desk.executor.greets = False
    desk.executor.drop()
    eventually(lambda: desk.planning.state()["mode"] == "fault")
    state = desk.planning.state()
    assert [fault["code"] for fault in state["faults"]] == ["executor-lost"]
    assert (state["configuration"], state["commanded"], state["measured"]) == (None, None, [None] * 12)
    inbox = Inbox()
    desk.planning.stop(inbox.replying("stop"))
    assert "the executor is not connected" in inbox.next("stop")["message"]
