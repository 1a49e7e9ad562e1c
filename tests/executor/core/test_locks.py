"""Locked actuators: what may be locked, and how their outputs are set."""

from typing import Any

from hyperbit.controller.executor.core.modes import RETRY
from hyperbit.controller.program import TICK, Cancel, Declined, Ended, Lock, Replaced, Replacement, Settled, unpack
from tests.executor.rig import SIZE, TRAVEL, Rig, ready

A = 0b000111


def test_a_locked_actuator_is_switched_by_no_program(rig: Rig) -> None:
    rig.send(Lock(1, 0, 0))
    assert rig.answer == (True, "locked: 1.left (contracted)")
    assert (unpack(rig.snapshot.locked), rig.snapshot.locks) == (1, 1)
    assert [fault.code for fault in rig.snapshot.faults] == ["degraded"]
    rig.run(A)
    assert rig.last(Declined).refused.reason.value == "program-locked"
    rig.follow(9, A)
    rig.run(A & ~1)
    rig.go(0.3)
    assert (rig.switched, rig.results) == ([A & ~1], [(2, "done")])
    rig.send(Lock(2, 0, -1))
    assert rig.answer == (True, "no actuator is locked")
    rig.run(A)
    rig.go(0.3)
    assert rig.switched[-1] == A


def test_a_lock_is_refused_while_the_arm_moves_and_against_an_end_stop(rig: Rig) -> None:
    rig.send(Lock(1, 0, 1))
    assert rig.answer == (False, "state: the end-stop of 1.left reads contracted")
    rig.send(Lock(1, SIZE, 1))
    assert not rig.answer[0]
    rig.run(A)
    rig.send(Lock(2, 0, 0))
    assert "the arm is executing" in rig.answer[1]
    rig.send(Cancel(3, None, ""))
    rig.send(Lock(4, 0, 0))
    assert (rig.mode, rig.answer[0]) == ("ready", False), "it still moves"
    rig.go(0.2)
    rig.send(Lock(5, 3, 0))
    assert rig.answer[0]


def test_a_stuck_actuator_is_locked_and_the_arm_goes_on_if_its_file_says_so() -> None:
    rig = ready(continue_on_stuck=True)
    rig.master.stuck, rig.master.back = 1, True
    rig.run(A)
    rig.go(RETRY + 0.3)
    assert (rig.mode, rig.reason) == ("ready", "holding what the boards measured, locked: 1.left (contracted)")
    rig.run(A ^ 0b110)
    rig.go(0.3)
    assert rig.results == [(1, "aborted"), (2, "done")]


LOCKED = 0b100011  # without end-stops, extended, their outputs off


def at_odds(**fields: Any) -> Rig:
    return ready(sensed=0, locked=LOCKED, locked_states=LOCKED, **fields)


def test_the_next_program_sets_the_outputs_of_locked_actuators_to_their_states() -> None:
    rig = at_odds()
    assert rig.switched == []
    program = rig.run(A & ~LOCKED)
    rig.send(Replacement(program.program, 1, 1, program.stages[0].states, program.stages[:0], True))
    rig.go(0.3)
    assert rig.last(Replaced).accepted
    assert (rig.switched, rig.results) == ([LOCKED, A | LOCKED], [(1, "done")])
    assert (rig.last(Settled).planned, rig.last(Ended).switches) == (True, 4)
    assert rig.journal.counts == [1, 1, 1, 0, 0, 1]
    rig.run(A | LOCKED, 0 | LOCKED)
    rig.go(0.5)
    assert rig.switched[2:] == [LOCKED]


def test_outputs_of_locked_actuators_are_set_within_the_bounds_on_inrush_and_rest() -> None:
    rig = at_odds(inrush=2, rest=0.2)
    rig.go(0.3)
    began = rig.now
    rig.run(0b1100)
    rig.go(0.5)
    assert rig.switched == [0b000011, LOCKED, LOCKED | 0b1100]
    assert [round(at - began, 2) for at, _ in rig.master.commits] == [0.0, TRAVEL, 2 * TRAVEL]


def test_a_set_point_with_stages_sets_the_outputs_of_locked_actuators() -> None:
    rig = at_odds()
    rig.follow(1)
    rig.go(2 * TICK)
    assert rig.switched == []
    rig.follow(1, 0b1100)
    rig.go(0.2)
    assert rig.switched == [LOCKED, LOCKED | 0b1100]


def test_a_locked_actuator_without_end_stop_is_measured_as_locked() -> None:
    rig = ready(sensed=0b111110, locked=1, locked_states=1)
    assert (unpack(rig.snapshot.measured), unpack(rig.snapshot.outputs)) == (1, 0)
