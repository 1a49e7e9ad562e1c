"""Set-points, on a played executor."""

import json
from typing import Any

import numpy as np
import pytest

from controller.program import (
    Cancel,
    Program,
    Setpoint,
    unpack,
)
from tests.planning.conftest import Desk
from tests.planning.test_goals import A, C
from tests.waiting import PATIENCE, eventually


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
    """Returns the next command of a stream that has stages."""
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


def status(desk: Desk) -> dict[str, Any]:
    """Returns the state of the stream in `diagnostics`."""
    status: dict[str, Any] = desk.planning.diagnostics()["setpoint"]
    return status


def test_a_cancel_ends_the_stream_until_it_pauses(desk: Desk, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(desk.planning._follower, "_timeout", PATIENCE)  # no pause of this machine ends the stream
    stream = Stream(desk, desk.tip(*A))
    first = moving(desk)
    desk.planning.cancel(desk.inbox.replying("canceled"))
    cancel = desk.executor.expect(Cancel, Setpoint)
    desk.executor.answer(cancel, "canceled")
    assert desk.inbox.next("canceled")["accepted"]
    eventually(lambda: not status(desk)["alive"])
    received = status(desk)["received"]
    eventually(lambda: status(desk)["received"] > received + 20)
    assert desk.executor.nothing(Setpoint)
    assert status(desk)["streams"] == 1
    stream.position = None
    monkeypatch.undo()
    eventually(lambda: status(desk)["rate"] == 0)
    stream.position = desk.tip(*A)
    command = desk.executor.expect(Setpoint)
    assert (command.stream > first.stream, command.epoch) == (True, 2)
    assert status(desk)["streams"] >= 2
    stream.position = None


def test_a_goal_ends_the_stream_before_it(desk: Desk) -> None:
    stream = Stream(desk, desk.tip(*A))
    moving(desk)
    desk.goal(C)
    program = desk.executor.expect(Program, Setpoint)
    desk.executor.accept(program)
    assert desk.inbox.next("reply")["accepted"]
    eventually(lambda: not status(desk)["alive"])
    stream.position = None
    late = [message for message in list(desk.executor._messages.queue) if isinstance(message, Setpoint)]
    assert all(message.stream < program.program for message in late), "the executor follows none of these"


def test_a_setpoint_out_of_reach_says_so(desk: Desk) -> None:
    stream = Stream(desk, [5.0, 5.0])
    while "out of reach at (5.0000, 5.0000)" not in (command := desk.executor.expect(Setpoint)).reason:
        pass
    assert command.stages == ()
    stream.position = None
