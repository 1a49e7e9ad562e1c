"""Strict programs and set-points: stages in order, and questions from unplanned states."""

from itertools import pairwise

import pytest

from hyperbit.controller.executor.motion.actuation import BUSY_FOR
from hyperbit.controller.executor.motion.motion import ANSWER_WITHIN
from hyperbit.controller.program import TICK, Clearance, Ended, Question, Replaced, Replacement, Stage, pack
from tests.executor.rig import SIZE, TRAVEL, Rig

A, B = 0b000111, 0b011100


def test_no_stage_is_skipped_or_begins_before_the_last_has_settled(rig: Rig) -> None:
    rig.run(A, B, 0, strict=True, begin=rig.now - 10)
    rig.go(0.5)
    assert rig.switched == [A, B, 0]
    times = [at for at, _ in rig.master.commits]
    assert min(b - a for a, b in pairwise(times)) >= TRAVEL - 1e-9
    assert (rig.of(Question), rig.results) == ([], [(1, "done")])


def partly_switched(rig: Rig) -> None:
    """Makes the first stage of a strict program switch on one of two buses only."""
    rig.master.partly = 0b000001
    rig.run(A, B, strict=True)
    rig.master.partly = 0
    rig.go(2 * TRAVEL)


def test_from_unplanned_states_the_executor_asks_and_holds_until_the_answer(rig: Rig) -> None:
    partly_switched(rig)
    (question,) = rig.of(Question)
    assert (question.start, question.stage) == (pack(0b000110, SIZE), pack(A, SIZE))
    rig.go(0.5)
    assert rig.switched == [A]
    rig.send(Clearance(question.question + 1, None))
    assert rig.switched == [A]
    rig.send(Clearance(question.question, None))
    assert rig.switched == [A, A]
    rig.go(0.5)
    assert rig.results == [(1, "done")]


def test_a_stage_that_is_not_clear_ends_the_program(rig: Rig) -> None:
    partly_switched(rig)
    rig.send(Clearance(rig.last(Question).question, "module 1 touches the floor"))
    assert rig.last(Ended).status == "aborted"
    assert rig.last(Ended).message == "the next stage cannot begin: module 1 touches the floor; the arm holds"
    assert (rig.mode, rig.switched) == ("ready", [A])


def test_the_program_ends_if_the_planner_does_not_answer(rig: Rig) -> None:
    partly_switched(rig)
    rig.go(ANSWER_WITHIN - 4 * TRAVEL)
    assert rig.results == []
    rig.go(4 * TRAVEL)
    assert rig.results == [(1, "aborted")]
    why = "the planner did not tell within 10 s whether the stage is clear"
    assert rig.last(Ended).message == f"the next stage cannot begin: {why}; the arm holds"


def test_the_program_ends_if_the_planner_dies_during_a_question(rig: Rig) -> None:
    partly_switched(rig)
    rig.alive = False
    rig.go(1.1)
    assert rig.results == [(1, "aborted")]
    assert (rig.mode, rig.reason) == ("ready", "holding; the planner is silent")


def test_an_answer_from_before_a_replacement_does_not_count(rig: Rig) -> None:
    """The planner replaces stages when obstacles have changed; it answered for the obstacles of before."""
    partly_switched(rig)
    first = rig.last(Question)
    rig.master.busy = True  # the stage cannot begin with the answer
    rig.send(Clearance(first.question, None))
    rig.send(Replacement(1, 1, 1, pack(A, SIZE), (Stage(pack(B, SIZE), at=0.3),), True))
    assert rig.last(Replaced).accepted
    rig.master.busy = False
    rig.go(0.1)
    second = rig.last(Question)
    assert (second.start, second.stage) == (first.start, first.stage)
    assert (rig.switched, second.question > first.question) == ([A], True)
    rig.send(Clearance(first.question, None))
    assert rig.switched == [A], "the answer is late"
    rig.send(Clearance(second.question, None))
    rig.go(0.5)
    assert (rig.switched, rig.results) == ([A, A, B], [(1, "done")])


def test_while_the_planner_is_asked_no_bus_counts_as_busy(rig: Rig) -> None:
    partly_switched(rig)
    rig.master.busy = True
    rig.send(Clearance(rig.last(Question).question, None))
    rig.send(Replacement(1, 1, 1, pack(A, SIZE), (Stage(pack(B, SIZE), at=0.3),), True))
    rig.go(2 * BUSY_FOR)
    rig.send(Clearance(rig.last(Question).question, None))
    rig.go(2 * TICK)
    assert rig.mode == "executing"
    rig.go(BUSY_FOR)
    assert rig.reason == "no command could be sent for 0.25 s: the queue is full"


def test_a_refused_replacement_keeps_the_question(rig: Rig) -> None:
    partly_switched(rig)
    rig.send(Replacement(1, 1, 1, pack(B, SIZE), (), True))
    assert not rig.last(Replaced).accepted
    rig.go(0.1)
    (question,) = rig.of(Question)
    rig.send(Clearance(question.question, None))
    assert rig.switched == [A, A]


def test_an_answer_is_used_once(rig: Rig) -> None:
    """The same stage from the same states may not be clear any more."""
    partly_switched(rig)
    rig.master.partly = 0b000001
    rig.send(Clearance(rig.last(Question).question, None))
    rig.go(0.2)
    assert len(rig.of(Question)) == 2


def test_an_answer_does_not_count_for_the_next_program(rig: Rig) -> None:
    partly_switched(rig)
    rig.master.busy = True
    rig.send(Clearance(rig.last(Question).question, None))
    rig.run(A, strict=True)
    assert rig.results == [(1, "replaced")]
    rig.master.busy = False
    rig.go()
    assert rig.switched == [A, A], "from the outputs, as it was planned"


def stray(rig: Rig) -> None:
    """Declares an actuator extended whose output is off: it is where no plan knows."""
    rig.core.locked.change(0, 1)
    rig.core.locked.states = 0
    rig.master.inputs = 0b000010
    rig.core.motion.supervision.accept(0b000010, 0b111111)


def test_a_refusal_does_not_count_for_the_next_program(rig: Rig) -> None:
    stray(rig)
    for _ in range(2):
        rig.run(0b001000, strict=True)
        rig.send(Clearance(rig.last(Question).question, "the post"))
        rig.go()
    assert (rig.results, len(rig.of(Question))) == ([(1, "aborted"), (2, "aborted")], 2)


def test_a_set_point_is_followed_stage_by_stage(rig: Rig) -> None:
    rig.follow(1, A)
    assert (rig.switched, rig.mode, rig.reason) == ([A], "executing", "following a setpoint")
    rig.follow(1, B)
    rig.go(2 * TICK)
    assert rig.switched == [A], "the last has not settled"
    rig.go(0.1)
    assert rig.switched == [A, B]


def test_a_stream_stops_when_no_more_comes(rig: Rig) -> None:
    rig.follow(1, A, B, strict=True, lasting=0.03)
    rig.go(0.3)
    assert (rig.switched, rig.mode, rig.reason) == ([A], "ready", "holding; the stream of setpoints has stopped")
    rig.follow(1, 0)
    assert rig.mode == "executing"


@pytest.mark.parametrize("fields", [{"epoch": 0}, {"start": 1}, {"stream": 2}, {"lasting": -1.0}])
def test_an_old_set_point_moves_nothing(rig: Rig, fields: dict) -> None:
    rig.run(0, number=3)
    rig.go(0.3)
    rig.follow(fields.get("stream", 4), A, **{k: v for k, v in fields.items() if k != "stream"})
    rig.go(0.1)
    assert rig.switched == []


def test_a_set_point_that_comes_too_late_ends_no_program(rig: Rig) -> None:
    rig.run(A, B)
    rig.follow(2, 0, lasting=-1.0)
    rig.go(0.5)
    assert (rig.results, rig.switched) == ([(1, "done")], [A, B])


def test_a_set_point_replaces_a_program_and_a_program_a_stream(rig: Rig) -> None:
    rig.run(A, B)
    rig.go(0.1)
    rig.follow(2, 0)
    rig.go(0.1)
    assert rig.results == [(1, "replaced")]
    rig.run(B, number=3)
    rig.follow(2, A)
    rig.go(0.5)
    assert rig.results == [(1, "replaced"), (3, "done")]
    assert rig.switched == [A, 0, B]


def test_while_a_set_point_waits_for_clearance_the_next_one_only_prolongs_it(rig: Rig) -> None:
    stray(rig)
    rig.follow(1, 0b001000, strict=True)
    (question,) = rig.of(Question)
    assert question.start == pack(0b000010, SIZE)
    rig.follow(1, 0b110000, strict=True, lasting=2.0)
    rig.go(0.5)
    rig.send(Clearance(question.question, None))
    assert rig.switched == [0b001000]
