"""Programs that come in parts: parked while the planner checks obstacles, continued, or given up by the planner."""

from itertools import pairwise

import pytest

from hyperbit.controller.executor.motion.program_execution import FED_WITHIN
from hyperbit.controller.program import TICK, Begun, Ended, Program, Replaced, Replacement, Settled, Stage, pack
from tests.executor.rig import SIZE, TRAVEL, Rig, ready

A, B, C = 0b000111, 0b011100, 0b110000


def stage(states: int, at: float, mark: int = -1) -> Stage:
    return Stage(pack(states, SIZE), at=at, mark=mark, settled=at + TRAVEL + TICK)


def replace(
    rig: Rig, generation: int, first: int, start: int, *stages: Stage, final: bool = False, strict: bool = False
) -> None:
    rig.send(Replacement(1, generation, first, pack(start, SIZE), stages, final, strict))
    assert rig.last(Replaced) == Replaced(1, generation, True)


def park(rig: Rig, generation: int, first: int, start: int, strict: bool = False) -> None:
    replace(rig, generation, first, start, strict=strict)


def marked(*stages: tuple[int, float, int], strict: bool = False) -> dict:
    return {"stages": tuple(stage(*fields) for fields in stages), "strict": strict}


def test_a_program_that_gets_no_further_stages_is_aborted(rig: Rig) -> None:
    rig.run(A, final=False)
    rig.go(FED_WITHIN)
    assert (rig.mode, rig.results) == ("executing", [])
    rig.go(1.0)
    assert rig.results == [(1, "aborted")]
    assert rig.last(Ended).message == "the planner sent no further stages for 10 s; the arm holds"
    assert rig.mode == "ready"
    assert rig.reason == "holding; goal 1 was aborted: the planner sent no further stages for 10 s"
    rig.run(B)
    rig.go(0.3)
    assert rig.results[-1] == (2, "done")


def test_the_time_counts_from_the_last_stage_and_not_from_its_message(rig: Rig) -> None:
    rig.run(final=False, stages=(stage(A, 0.0), stage(B, FED_WITHIN)))
    rig.go(2 * FED_WITHIN - 1)
    assert rig.mode == "executing"
    replace(rig, 1, 2, B, stage(C, 2 * FED_WITHIN))
    rig.go(FED_WITHIN)
    assert (rig.mode, rig.switched) == ("executing", [A, B, C])
    rig.go(2.0)
    assert rig.results == [(1, "aborted")]


def test_a_program_without_stages_yet_is_aborted_too(rig: Rig) -> None:
    rig.run(final=False)
    rig.go(FED_WITHIN + 1)
    assert rig.results == [(1, "aborted")]


def test_replacements_without_stages_do_not_prolong_a_program(rig: Rig) -> None:
    rig.run(A, final=False)
    for generation in range(12):
        if rig.results:
            break
        park(rig, generation, 1, A)
        rig.go(1.0)
    assert rig.results == [(1, "aborted")]


def test_a_halted_executor_does_not_count_against_the_planner(rig: Rig) -> None:
    rig.run(A, final=False)
    rig.go(0.5)
    rig.agenda.run(2 * FED_WITHIN)
    rig.go()
    assert (rig.mode, rig.results) == ("executing", [])


@pytest.mark.parametrize("strict", [False, True])
def test_a_parked_program_holds_and_continues(rig: Rig, strict: bool) -> None:
    rig.run(**marked((A, 0.0, 0), (B, 0.2, 1), (C, 0.4, 2), strict=strict))
    rig.go(0.1)
    park(rig, 1, 1, A)
    rig.go(1.0)
    assert (rig.switched, rig.marks, rig.mode, rig.results) == ([A], [0], "executing", [])
    replace(rig, 2, 1, A, stage(B, 1.2, 1), stage(C, 1.4, 2), final=True)
    rig.go(1.0)
    assert (rig.switched, rig.marks, rig.results) == ([A, B, C], [0, 1, 2], [(1, "done")])
    assert [(s.stages, s.planned) for s in rig.of(Settled)] == [(1, True)] * 3
    assert [b.stage for b in rig.of(Begun)] == [0, 1, 2]


def test_a_mark_that_is_cut_off_in_mid_stage_and_appended_again_is_reported_once(rig: Rig) -> None:
    """The stages to mark 1 are cut apart: what was carried out before the parking counts for its report."""
    rig.run(**marked((A, 0.0, 0), (B, 0.2, -1), (C, 0.4, 1)))
    rig.go(0.3)
    park(rig, 1, 2, B)
    park(rig, 2, 2, B)
    rig.go(0.3)
    replace(rig, 3, 2, B, stage(C, 0.7, 1), stage(A, 0.9, 2))
    park(rig, 4, 2, B)
    replace(rig, 5, 2, B, stage(C, 0.8, 1), final=True)
    rig.go(0.5)
    assert (rig.switched, rig.marks, rig.results) == ([A, B, C], [0, 1], [(1, "done")])
    assert [(s.mark, s.stages, s.planned) for s in rig.of(Settled)] == [(0, 1, True), (1, 2, True)]


def test_other_stages_than_the_ones_cut_off_count_as_planned_and_skipped_ones_do_not(rig: Rig) -> None:
    rig.run(**marked((A, 0.0, 0), (B, 0.2, 1)))
    rig.go(0.1)
    park(rig, 1, 1, A)
    rig.go(1.0)
    replace(rig, 2, 1, A, stage(C, 0.4, 1))
    assert rig.switched == [A, C]
    rig.go(0.3)
    replace(rig, 3, 2, C, stage(A, 0.5), stage(B, 0.6, 2), final=True)
    rig.go(0.3)
    assert (rig.switched, rig.results) == ([A, C, B], [(1, "done")])
    assert [(s.mark, s.planned) for s in rig.of(Settled)] == [(0, True), (1, True), (2, False)]


def test_a_mark_settles_while_its_program_is_parked(rig: Rig) -> None:
    rig.run(**marked((A, 0.0, 0), (B, 0.2, 1)))
    park(rig, 1, 1, A)
    assert rig.marks == []
    rig.go(0.2)
    assert (rig.marks, rig.mode) == ([0], "executing")


@pytest.mark.parametrize("strict", [False, True])
def test_a_program_parks_when_nothing_is_left_to_run(rig: Rig, strict: bool) -> None:
    program = rig.run(**marked((A, 0.0, 0)), final=True)
    park(rig, 1, 1, A, strict)
    rig.go(1.0)
    assert (rig.marks, rig.mode, rig.results) == ([0], "executing", [])
    rig.send(Replacement(program.program, 2, 1, pack(A, SIZE), (), True))
    rig.go()
    assert (rig.marks, rig.results) == ([0], [(1, "done")])


def test_a_program_parks_before_its_first_stage(rig: Rig) -> None:
    rig.run(A, begin=rig.now + 0.5)
    park(rig, 1, 0, 0)
    rig.go(1.0)
    assert (rig.switched, rig.mode) == ([], "executing")
    replace(rig, 2, 0, 0, stage(B, 0.6, 0), final=True)
    rig.go(0.3)
    assert (rig.switched, rig.marks, rig.results) == ([B], [0], [(1, "done")])


def test_a_parked_program_finishes_the_stage_under_way(rig: Rig) -> None:
    rig.master.slow_sync = True
    rig.run(**marked((A, 0.0, 0), (B, 0.2, 1)))
    park(rig, 1, 1, A)
    rig.master.slow_sync = False
    rig.go(1.0)
    assert (rig.switched, rig.marks, rig.results) == ([A], [0], [])


def test_a_replacement_without_stages_makes_a_program_strict_where_nothing_is_left_to_begin(rig: Rig) -> None:
    program: Program = rig.run(A, final=False)
    replace(rig, 1, 1, A, strict=True)
    replace(rig, 2, 1, A, stage(B, 0.1, 1), stage(C, 0.1, 2), final=True)
    rig.go(0.5)
    times = [at for at, _ in rig.master.commits]
    assert (rig.switched, rig.marks, rig.results) == ([A, B, C], [0, 1, 2], [(program.program, "done")])
    assert min(later - earlier for earlier, later in pairwise(times)) >= TRAVEL - 1e-9


def test_a_parked_program_homes_no_actuator_to_another_state() -> None:
    """A jog homes to its last stage; without stages the executor does not know where to."""
    rig = ready(channel={"output_off": True}, sensed=0)
    assert rig.core.motion.readings.homing == 0b111111
    rig.run(0b000001, homed=0b000001, begin=rig.now + 0.5)
    park(rig, 1, 0, 0)
    before = list(rig.switched)
    rig.go(0.5)
    assert rig.switched == before
