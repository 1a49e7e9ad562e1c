"""A simulated arm: what clients see of it, and faults that they have played."""

from __future__ import annotations

from collections.abc import Callable

from hyperbit.controller.arm.arm import Arm
from hyperbit.controller.program import Answer, FaultVerb, PlayableFaults, PlayFault
from hyperbit.controller.refusals.reasons import Reason
from hyperbit.controller.refusals.refusal import Refusal
from hyperbit.controller.workspace.densities import Densities
from tests.planning.rig.desk import Desk

SIMULATION = PlayableFaults((FaultVerb("silence", "board", "", "disconnect it"),), ("can0/1",), ("can0",), ())
SILENCE = {"fault": "silence can0/1"}


def test_a_simulated_arm_says_so(make_desk: Callable[..., Desk], small: Arm, small_densities: Densities) -> None:
    desk = make_desk(small, small_densities, simulation=SIMULATION)
    assert desk.state()["simulated"] is True
    desk.ask("arm")
    described = desk.inbox.next("reply")
    assert described["simulated"] is True
    verb = {"verb": "silence", "target": "board", "argument": "", "text": "disconnect it"}
    assert described["simulation"] == {"faults": [verb], "boards": ["can0/1"], "buses": ["can0"], "interlocks": []}
    desk.drop()
    assert desk.state()["simulated"] is True
    desk.ask("arm")
    assert desk.inbox.next("reply")["simulation"] is None


def test_a_fault_is_played_by_the_executor(
    make_desk: Callable[..., Desk], small: Arm, small_densities: Densities
) -> None:
    desk = make_desk(small, small_densities, simulation=SIMULATION)
    number = desk.ask("fault", SILENCE)
    assert desk.executor.take() == PlayFault(number, "silence can0/1")
    assert desk.inbox.empty
    desk.executor.send(Answer(number, "done: silence can0/1"))
    answer = desk.inbox.next("reply")
    assert (answer["accepted"], answer["message"]) == (True, "done: silence can0/1")
    number = desk.ask("fault", SILENCE)
    desk.executor.send(Answer(number, "why", Refusal(Reason.NO_SUCH_FAULT, why="why").data))
    assert desk.inbox.next("reply")["reason"] == "no-such-fault"


def test_a_real_arm_plays_no_fault(desk: Desk) -> None:
    assert desk.state()["simulated"] is False
    desk.ask("fault", SILENCE)
    answer = desk.inbox.next("reply")
    assert (answer["accepted"], answer["reason"]) == (False, "not-simulated")
    assert desk.executor.take() is None
