"""Motion supervision: stuck only after a question, and no delay of the executor counts for an actuator."""

import pytest

from hyperbit.controller.program import TICK, Ended, Reset
from tests.executor.rig import MARGIN, SIZE, TRAVEL, Rig, ready

ALL = (1 << SIZE) - 1


def test_an_actuator_that_does_not_arrive_is_stuck_after_its_board_has_answered(rig: Rig) -> None:
    rig.master.stuck = 1
    rig.run(0b000111)
    rig.go(TRAVEL + MARGIN - TICK)
    assert rig.mode != "fault"
    rig.go(4 * TICK)
    assert (rig.mode, rig.results) == ("fault", [(1, "aborted")])
    assert rig.faults == [("stuck", "1.left (can0/1 output 0)")]
    assert "did not become extended within 0.08 s; its end-stop does not read extended" in rig.last(Ended).message
    assert {board for board, _ in rig.master.questions} == {0}


def test_a_lost_message_of_an_end_stop_is_made_up_for_by_the_question(rig: Rig) -> None:
    rig.master.stuck, rig.master.answers = 1, False
    rig.run(1)
    rig.go(TRAVEL + MARGIN + 2 * TICK)
    assert (rig.mode, rig.master.questioning(0)) == ("executing", True)
    rig.master.inputs |= 1  # the answer tells
    rig.master.answers = True
    rig.go(0.1)
    assert rig.results == [(1, "done")]


def test_an_actuator_is_stuck_also_after_a_question_that_times_out(rig: Rig) -> None:
    rig.master.stuck, rig.master.answers = 1, False
    rig.run(1)
    rig.go(0.2)
    assert rig.mode != "fault"
    rig.master.answers = True
    rig.go(3 * TICK)
    assert rig.mode == "fault"


def test_a_stall_of_the_executor_is_no_delay_of_an_actuator(rig: Rig) -> None:
    rig.master.stuck = 1
    rig.run(1)
    rig.go(TICK)
    rig.agenda.run(0.3)
    rig.go(TICK)
    assert rig.mode != "fault"
    rig.master.inputs |= 1
    rig.go(0.1)
    assert rig.results == [(1, "done")]


def test_the_margin_is_the_arms() -> None:
    rig = ready(margin=0.5)
    rig.master.stuck = 1
    rig.run(1)
    rig.go(TRAVEL + 0.4)
    assert rig.mode != "fault"
    rig.go(0.2)
    assert rig.mode == "fault"


@pytest.mark.parametrize("stuck_at", [0, 1])
def test_an_actuator_toggled_at_every_transition_that_never_arrives_is_found(rig: Rig, stuck_at: int) -> None:
    if stuck_at:
        rig.run(1)
        rig.go(0.2)
    rig.master.stuck = 1
    commands = 0
    while rig.mode != "fault" and commands < 20:
        commands += 1
        rig.run(rig.master.outputs ^ 1, step=1)
        rig.go(TRAVEL + TICK)
    assert 5 <= commands <= 8, "after the third that was missed: every other one is"
    assert "missed 3 commands" in rig.reason


def test_an_actuator_toggled_as_fast_that_arrives_is_not_stuck(rig: Rig) -> None:
    for _ in range(20):
        rig.run(rig.master.outputs ^ 1, step=1)
        rig.go(TRAVEL + TICK)
    assert rig.mode != "fault"


def test_missed_commands_are_forgotten_when_the_end_stop_changes(rig: Rig) -> None:
    for _ in range(3):
        rig.master.stuck = 1
        for _ in range(4):  # two are missed: the others are for the state in which it is stuck
            rig.run(rig.master.outputs ^ 1, step=1)
            rig.go(TRAVEL + TICK)
        rig.master.stuck = 0
        for _ in range(2):
            rig.run(rig.master.outputs ^ 1, step=1)
            rig.go(TRAVEL + TICK)
    assert rig.mode != "fault"


def test_one_that_moves_by_itself_is_a_fault(rig: Rig) -> None:
    rig.master.inputs |= 0b000010
    rig.go()
    assert ([board for board, _ in rig.master.questions], rig.mode) == ([0], "ready")
    rig.go()
    assert (rig.mode, rig.faults) == ("fault", [("unexpected-motion", "1.diagonal (can0/1 output 1)")])


def test_one_that_moves_by_itself_is_a_fault_though_its_board_answers_late(rig: Rig) -> None:
    rig.master.answers = False
    rig.master.inputs |= 0b000010
    rig.go(0.2)
    assert rig.mode == "ready"
    rig.master.answers = True
    rig.go()
    assert rig.faults == [("unexpected-motion", "1.diagonal (can0/1 output 1)")]


def test_a_contact_that_bounces_is_no_fault(rig: Rig) -> None:
    for _ in range(10):
        rig.master.inputs ^= 0b000010
        rig.go()
        rig.master.inputs ^= 0b000010
        rig.go(2 * TICK)
    assert (rig.mode, rig.faults) == ("ready", [])
    rig.run(ALL)
    rig.go(0.3)
    assert rig.results == [(1, "done")]


def test_without_end_stops_only_the_travel_time_tells() -> None:
    rig = ready(sensed=0)
    rig.run(ALL)
    assert rig.core.motion.moving
    rig.go(TRAVEL + TICK)
    assert not rig.core.motion.moving
    rig.go(0.2)
    assert (rig.mode, rig.results, rig.master.questions) == ("ready", [(1, "done")], [])


def test_a_lost_board_ends_the_motions_of_its_actuators(rig: Rig) -> None:
    rig.master.stuck = 1
    rig.run(1)
    rig.go(TICK)
    rig.master.known = 0b111000
    rig.go(0.2)
    assert not rig.core.motion.moving
    assert rig.mode != "fault", "that a board is lost is for the master to say"


BOTH = {"input_contracted": True}


def far(k: int) -> int:
    """The line of the contracted end of an actuator."""
    return 1 << SIZE + k


@pytest.mark.parametrize(("direction", "reads"), [(1, "contracted"), (0, "extended")])
def test_one_with_two_end_stops_that_stays_at_its_start_is_stuck_there(direction: int, reads: str) -> None:
    rig = ready(channel=BOTH)
    if not direction:
        rig.run(1)
        rig.go(0.2)
    rig.master.stuck = 1
    rig.run(direction)
    rig.go(0.2)
    assert rig.faults == [("stuck", "1.left (can0/1 output 0)")]
    assert rig.reason.endswith(f"its end-stop still reads {reads}")


def test_one_with_two_end_stops_that_stays_between_them_is_stuck_there_also_after_a_reset() -> None:
    rig = ready(channel=BOTH)
    rig.master.halfway = 1
    rig.run(1)
    rig.go(TRAVEL)
    assert rig.core.motion.moving
    rig.go(0.2)
    assert rig.reason.endswith("it has left its contracted end, and neither end-stop reads")
    rig.send(Reset(1, rig.epoch))
    rig.go(0.3)
    assert (rig.mode, rig.faults) == ("fault", [("stuck", "1.left (can0/1 output 0)")])
    rig.master.halfway = 0
    rig.master.inputs |= 1
    rig.send(Reset(2, rig.epoch))
    rig.go(0.3)
    assert (rig.mode, rig.snapshot.faults) == ("ready", ())


@pytest.mark.parametrize("late", [False, True])
def test_a_result_waits_until_the_old_end_stop_has_decided(rig: Rig, late: bool) -> None:
    """The new end has no end-stop; that of the old end opens late, or never."""
    rig.run(1)
    rig.go(0.2)
    rig.master.stuck = 1
    rig.run(0)
    rig.go(TRAVEL + 2 * TICK)
    assert rig.results == [(1, "done")]
    if late:
        rig.master.stuck, rig.master.inputs = 0, 0
    rig.go(0.2)
    assert rig.results == [(1, "done"), (2, "done" if late else "aborted")]
    if not late:
        assert rig.faults == [("stuck", "1.left (can0/1 output 0)")]
        assert rig.reason.endswith("did not become contracted within 0.08 s; its end-stop still reads extended")


def test_a_retraction_takes_its_travel_time_though_its_end_stop_has_opened(rig: Rig) -> None:
    rig.run(1)
    rig.go(0.2)
    rig.run(0)
    rig.go(2 * TICK)
    assert rig.master.inputs & 1 == 0
    assert rig.core.motion.moving
    rig.go(TRAVEL)
    assert not rig.core.motion.moving


def test_two_end_stops_tell_the_arrival_before_the_travel_time() -> None:
    rig = ready(channel={**BOTH, "travel": (1.0, 1.0)})
    rig.run(1)
    rig.go(0.5)
    assert rig.core.motion.moving
    rig.master.inputs |= 1
    rig.go()
    assert not rig.core.motion.moving


def test_each_direction_has_its_own_time() -> None:
    rig = ready(channel={"travel": (0.4, 0.1)}, sensed=0)
    rig.go(0.4)  # what an executor before has switched would have settled
    for states, time in ((1, 0.1), (0, 0.4)):
        rig.run(states)
        rig.go(time - TICK)
        assert rig.core.motion.moving
        rig.go(2 * TICK)
        assert not rig.core.motion.moving
        rig.go(0.1)
    assert rig.results == [(1, "done"), (2, "done")]


@pytest.mark.parametrize("moving", [False, True])
def test_both_end_stops_at_once_are_a_fault_of_their_own_after_the_board_was_asked(moving: bool) -> None:
    rig = ready(channel=BOTH)
    if moving:
        rig.run(1)
        rig.go(TICK)
    rig.master.answers = False
    rig.master.inputs |= 1 | far(0)
    rig.go(4 * TICK)
    assert rig.mode != "fault"
    rig.master.answers = True
    rig.go(2 * TICK)
    assert (rig.mode, rig.faults) == ("fault", [("end-stops", "1.left (can0/1 output 0)")])
    rig.send(Reset(1, rig.epoch))
    rig.go(0.2)
    assert (rig.mode, rig.faults) == ("fault", [("end-stops", "1.left (can0/1 output 0)")])
    rig.master.inputs &= ~far(0)
    rig.send(Reset(2, rig.epoch))
    rig.go(0.2)
    assert rig.mode == "ready"


def test_both_end_stops_for_an_instant_are_none() -> None:
    rig = ready(channel=BOTH)
    rig.master.answers = False
    rig.master.inputs |= 1
    rig.go(TICK)
    rig.master.inputs &= ~1
    rig.master.answers = True
    rig.go(0.2)
    assert rig.mode == "ready"


@pytest.mark.parametrize(("lines", "words"), [(0, "does not read contracted any more"), (1, "reads extended")])
def test_leaving_an_end_unasked_is_a_fault(lines: int, words: str) -> None:
    rig = ready(channel=BOTH)
    rig.master.inputs = rig.master.inputs & ~far(0) | lines
    rig.go(2 * TICK)
    assert rig.faults == [("unexpected-motion", "1.left (can0/1 output 0)")]
    assert words in rig.reason


def test_a_single_end_stop_at_the_contracted_end_is_used() -> None:
    rig = ready(channel=BOTH, sensed=0)
    rig.run(1)
    rig.go(0.2)
    assert (rig.results, rig.core.motion.readings.measured) == ([(1, "done")], 1)
    rig.master.stuck = 1
    rig.run(0)
    rig.go(0.2)
    assert rig.reason.endswith("its end-stop does not read contracted")


def stuck_and_reset() -> Rig:
    """Returns a rig after a reset, with an actuator that has not followed its output, which is still on."""
    rig = ready()
    rig.master.stuck = 1
    rig.run(0b000111)
    rig.go(0.2)
    assert rig.mode == "fault"
    rig.send(Reset(1, rig.epoch))
    rig.go(0.2)
    assert (rig.mode, rig.master.outputs) == ("ready", 0b000111)
    return rig


def test_the_next_program_lets_go_of_an_actuator_that_was_stuck() -> None:
    rig = stuck_and_reset()
    rig.run(0b000110)
    rig.go(0.3)
    assert (rig.master.outputs, rig.results[-1]) == (0b000110, (2, "done"))


def test_an_actuator_that_was_stuck_and_is_used_again_is_found_again() -> None:
    rig = stuck_and_reset()
    rig.run(0b000111)  # its output need not change for that
    rig.go(0.2)
    assert (rig.mode, rig.results[-1]) == ("fault", (2, "aborted"))
    assert rig.faults == [("stuck", "1.left (can0/1 output 0)")]
    rig.send(Reset(2, rig.epoch))
    rig.go(0.2)
    rig.master.stuck = 0
    rig.master.inputs |= 1  # it comes loose, and arrives
    rig.go(0.1)
    assert rig.faults == [("unexpected-motion", "1.left (can0/1 output 0)")]
