"""Programs from acceptance to their one result."""

from itertools import pairwise

import pytest

from hyperbit.controller.program import (
    TICK,
    Accepted,
    Begun,
    Declined,
    Ended,
    Replaced,
    Replacement,
    Reset,
    Settled,
    Stage,
    Stop,
    pack,
)
from hyperbit.controller.refusals.reasons import Reason
from hyperbit.controller.refusals.refusal import Refused
from tests.executor.rig import MARGIN, SIZE, TRAVEL, Rig, ready

A, B, C = 0b000111, 0b011100, 0b110000


def test_a_program_is_run_to_its_end(rig: Rig) -> None:
    program = rig.run(A, B, context=b"x")
    assert rig.last(Accepted) == Accepted(program.program, rig.now)
    assert rig.switched == [A], "the first stage does not wait for the tick"
    rig.go(2 * TICK)
    assert (rig.mode, rig.reason) == ("executing", "goal 1")
    rig.go(0.5)
    assert rig.switched == [A, B]
    assert [b.stage for b in rig.of(Begun)] == [0, 1]
    assert [(s.mark, s.switches, s.stages, s.planned) for s in rig.of(Settled)] == [(0, 3, 1, True), (1, 7, 1, True)]
    (ended,) = rig.of(Ended)
    assert (ended.status, ended.context, ended.mark, ended.switches) == ("done", b"x", 1, 7)
    assert ended.measured == pack(B, SIZE)
    assert (rig.mode, rig.reason) == ("ready", "holding; goal 1 is done")
    assert rig.journal.counts == [2, 2, 1, 1, 1, 0]


def test_marks_settle_at_their_time_and_not_before_the_end_stop(rig: Rig) -> None:
    rig.run(A, stages=(Stage(pack(A, SIZE), at=0.0, mark=5, settled=0.3),))
    rig.go(0.28)
    assert rig.marks == []
    rig.go(0.03)
    assert rig.marks == [5]


def test_no_mark_settles_while_an_actuator_moves(rig: Rig) -> None:
    rig.master.stuck = 1
    rig.run(A)
    rig.go(TRAVEL + MARGIN - TICK)
    assert rig.marks == []
    rig.master.inputs |= 1
    rig.go(2 * TICK)
    assert rig.marks == [0]


def test_overdue_stages_are_skipped(rig: Rig) -> None:
    rig.run(A, B, C, begin=rig.now - 10.0)
    rig.go(0.5)
    assert (rig.switched, rig.marks, rig.results) == ([C], [2], [(1, "done")])
    assert rig.last(Settled).planned is False


def test_a_stage_that_switches_nothing_counts_as_taken(rig: Rig) -> None:
    rig.run(0, A, A)
    rig.go(0.6)
    assert rig.switched == [A]
    assert [(s.mark, s.stages, s.planned) for s in rig.of(Settled)] == [(0, 0, True), (1, 1, True), (2, 0, True)]
    assert rig.results == [(1, "done")]


def test_a_program_without_stages_is_done_at_once(rig: Rig) -> None:
    rig.run()
    rig.go()
    assert (rig.switched, rig.results) == ([], [(1, "done")])


def test_a_new_program_replaces_the_running_one(rig: Rig) -> None:
    rig.run(A, B)
    rig.go(0.1)
    rig.run(C)
    rig.go(0.5)
    assert rig.results == [(1, "replaced"), (2, "done")]
    assert rig.of(Ended)[0].message == "replaced by goal 2"
    assert rig.switched == [A, C]


@pytest.mark.parametrize(
    ("fields", "reason"),
    [
        ({"epoch": 0}, "overtaken"),
        ({"start": 1}, "moved-since-planned"),
        ({"number": 0}, "program-malformed"),
        ({"stages": (Stage(b"", 0.0),)}, "program-malformed"),
        ({"stages": (Stage(b"\xff", 0.0),)}, "program-malformed"),
        ({"stages": (Stage(pack(A, SIZE), 1.0), Stage(pack(B, SIZE), 0.5))}, "program-malformed"),
    ],
)
def test_a_program_that_does_not_fit_is_declined(rig: Rig, fields: dict, reason: str) -> None:
    rig.run(A, **fields)
    assert rig.last(Declined).refused.reason.value == reason
    rig.go(0.2)
    assert (rig.mode, rig.switched, rig.results) == ("ready", [], [])


def test_a_program_during_a_switch_is_declined_with_this_reason(rig: Rig) -> None:
    rig.master.slow_sync = True
    rig.run(A)
    rig.go(TICK)
    rig.run(B, start=0)
    declined = rig.last(Declined)
    assert declined.refused == Refused(Reason.SWITCH_NOT_CONFIRMED)


def test_stages_over_the_inrush_limit_are_declined_and_others_wait_for_the_previous_stage() -> None:
    rig = ready(inrush=2)
    rig.run(A)
    assert rig.last(Declined).refused.reason.value == "program-malformed"
    rig.run(0b000011, 0b001111, 0b111111, step=0.0)
    rig.go(1)
    times = [at for at, _ in rig.master.commits]
    assert rig.switched == [0b000011, 0b001111, 0b111111]
    assert min(b - a for a, b in pairwise(times)) >= TRAVEL - 1e-9
    assert rig.results == [(2, "done")]


def test_the_latest_stage_within_the_inrush_is_taken_else_the_next() -> None:
    rig = ready(inrush=2)
    rig.run(0b000001, 0b000011, 0b000111, 0b001111, step=0.0)
    rig.go(1)
    assert rig.switched == [0b000011, 0b001111]
    assert rig.marks[-1] == 3


def test_an_actuator_rests() -> None:
    rig = ready(rest=0.3)
    rig.run(1, 0, 1, step=0.0, strict=True)
    rig.go(2)
    times = [at for at, _ in rig.master.commits]
    assert rig.switched == [1, 0, 1]
    assert min(b - a for a, b in pairwise(times)) >= TRAVEL + 0.3 - 1e-9


def test_all_actuators_rest_after_a_start_and_those_whose_outputs_fell_after_a_boot() -> None:
    """The executor before may have switched them just now."""
    rig = ready(rest=0.3)
    began = rig.now
    rig.run(A)
    rig.go(1)
    assert rig.master.commits[0][0] - began >= 0.3 - 3 * TICK
    assert rig.results == [(1, "done")]
    rig.send(Stop(1))
    rig.master.outputs = rig.master.inputs = A & 1  # a board has lost its supply
    rig.send(Reset(2, rig.epoch))
    rig.go(3 * TICK)
    booted = rig.now
    rig.run(1 | 0b100000, A)
    rig.go(1)
    at_once, rested = (at for at, _ in rig.master.commits[-2:])
    assert at_once - booted < 0.02
    assert rested - booted >= TRAVEL + 0.3 - 4 * TICK


def test_a_program_comes_in_parts_and_holds_until_more_comes(rig: Rig) -> None:
    program = rig.run(A, final=False)
    rig.go(0.5)
    assert (rig.marks, rig.results, rig.mode) == ([0], [], "executing")
    more = (Stage(pack(B, SIZE), at=0.6, mark=1, settled=0.7),)
    rig.send(Replacement(program.program, 1, 1, pack(A, SIZE), more, True))
    assert rig.last(Replaced) == Replaced(program.program, 1, True)
    rig.go(0.5)
    assert (rig.switched, rig.marks, rig.results) == ([A, B], [0, 1], [(1, "done")])


def replacement(program: int = 1, generation: int = 2, first: int = 1, start: int = A, at: float = 0.3) -> Replacement:
    return Replacement(program, generation, first, pack(start, SIZE), (Stage(pack(C, SIZE), at=at),), True)


@pytest.mark.parametrize(
    "message",
    [
        replacement(program=2),
        replacement(generation=0),
        replacement(first=0, start=0),
        replacement(first=3, start=B),
        replacement(start=B),
        replacement(at=-1.0),
    ],
)
def test_a_replacement_that_does_not_fit_changes_nothing(rig: Rig, message: Replacement) -> None:
    rig.run(A, B)
    rig.go(0.1)
    rig.send(Replacement(1, 1, 2, pack(B, SIZE), (), True))
    rig.send(message)
    assert rig.last(Replaced).accepted is False
    rig.go(0.5)
    assert (rig.switched, rig.results) == ([A, B], [(1, "done")])


def test_a_replacement_replaces_stages_that_have_not_begun(rig: Rig) -> None:
    rig.run(A, B)
    rig.go(0.1)
    rig.send(replacement())
    rig.go(0.5)
    assert (rig.switched, rig.results) == ([A, C], [(1, "done")])


def test_the_result_waits_for_the_stage_under_way_and_counts_it(rig: Rig) -> None:
    rig.master.slow_sync = True
    rig.run(A, B)
    rig.gone()
    assert rig.of(Ended) == []
    rig.master.slow_sync = False
    rig.go(2 * TICK)
    rig.connect()
    (ended,) = rig.of(Ended)
    assert (ended.status, ended.switches, ended.message) == ("aborted", 3, "the planner is gone; the arm holds")
    rig.go(0.5)
    assert (rig.switched, rig.mode) == ([A], "ready")


def test_while_a_stage_is_switched_a_program_is_asked_to_plan_anew(rig: Rig) -> None:
    rig.master.slow_sync = True
    rig.run(A, B)
    rig.run(C)
    assert rig.last(Declined).refused.reason.value == "switch-not-confirmed"
