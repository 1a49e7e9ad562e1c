"""Actuators with two outputs: at most one is on, pulses end in every mode, and unknown states are homed first."""

from __future__ import annotations

import itertools
import math
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hyperbit.controller.executor.motion.actuation import LATE
from hyperbit.controller.host.process import Quit
from hyperbit.controller.program import TICK, Alive, Cancel, Reset, Stop, unpack
from tests.executor.rig import LOST, SIZE, TRAVEL, Rig, ready

ALL = (1 << SIZE) - 1
PULSE = 0.05
NAMES = ("left", "diagonal", "right")
DOUBLE: dict[str, Any] = {"output_off": True}
BISTABLE: dict[str, Any] = {"output_off": True, "pulse": PULSE}
SAME = {**BISTABLE, "input_contracted": True}


def lines(extending: int, contracting: int) -> int:
    return extending | contracting << SIZE


def pulses(rig: Rig) -> list[float]:
    """Returns the lengths of the first actuator's pulses [s]."""
    times = [at for at, mask in rig.master.left if mask & lines(1, 1)]
    return [round(off - on, 4) for on, off in zip(times[::2], times[1::2], strict=True)]


@pytest.mark.parametrize("channel", [DOUBLE, BISTABLE])
def test_a_start_energises_nothing(channel: dict[str, Any]) -> None:
    rig = ready(channel=channel, sensed=0)
    rig.go(1.0)
    assert (rig.switched, rig.master.outputs) == ([], 0)
    assert unpack(rig.snapshot.homing) == ALL
    assert unpack(rig.snapshot.known) == 0
    assert "unknown-position" in {fault.code for fault in rig.snapshot.faults}


def test_a_goal_homes_actuators_of_unknown_state_to_its_start() -> None:
    rig = ready(channel=BISTABLE, sensed=0)
    rig.run(0b000001, 0b000011)
    rig.go(1.0)
    assert rig.results == [(1, "done")]
    assert rig.switched == [lines(0, ALL), lines(1, 0), lines(2, 0)]
    (homed, *_), (first, _), _ = rig.master.left[0], rig.master.left[2], rig.master.left[4]
    assert first - homed >= TRAVEL, "the first stage waits until all are there"
    assert unpack(rig.snapshot.homing) == 0
    assert unpack(rig.snapshot.known) == ALL
    assert not rig.snapshot.faults


def test_no_stage_is_skipped_because_homing_took_time() -> None:
    rig = ready(channel=BISTABLE, sensed=0)
    rig.run(1, 3, 1, step=0.04)
    rig.go(1.0)
    assert rig.switched == [lines(0, ALL), lines(1, 0), lines(3, 0), lines(0, 2)]


def test_an_actuator_found_with_both_outputs_on_is_in_an_unknown_state() -> None:
    rig = ready(channel=BISTABLE, sensed=0)
    rig.run(1)
    rig.go(0.5)
    assert unpack(rig.snapshot.homing) == 0
    rig.master.fail(LOST)
    rig.go()
    rig.master.outputs = lines(2, 2)  # another program was there
    rig.send(Reset(1, rig.epoch))
    rig.go(0.5)
    assert (rig.mode, unpack(rig.snapshot.homing), rig.master.outputs) == ("ready", 2, 0)


def test_a_jog_brings_only_its_own_actuator_to_a_known_state() -> None:
    rig = ready(channel=BISTABLE, sensed=0)
    rig.run(0b000000, homed=0b000100)
    rig.go(0.5)
    assert rig.switched == [lines(0, 0b000100)]
    rig.run(0b000010, homed=0b000010)
    rig.go(0.5)
    assert rig.switched[1:] == [lines(0b000010, 0)]
    assert unpack(rig.snapshot.homing) == ALL & ~0b000110
    assert rig.results == [(1, "done"), (2, "done")]


def test_homing_keeps_the_bound_on_inrush_and_the_rests() -> None:
    rig = ready(channel=BISTABLE, sensed=0, inrush=4)
    rig.run(0b000001)
    rig.go(1.0)
    assert rig.switched == [lines(0, 0b001111), lines(0, 0b110000), lines(1, 0)]
    times = [at for at, _ in rig.master.left[::2]]
    assert all(after - before >= TRAVEL for before, after in itertools.pairwise(times))


def test_end_stops_tell_the_state_after_a_start() -> None:
    rig = Rig(channel=SAME)
    rig.master.inputs, rig.master.targets = 0b000011 | 0b111100 << SIZE, 0b000011
    rig.connect()
    rig.go(0.2)
    assert (rig.mode, rig.states, unpack(rig.snapshot.homing)) == ("ready", 0b000011, 0)
    rig.run(0b000110)
    rig.go(0.5)
    assert rig.switched == [lines(0b100, 0b001)]
    assert rig.results == [(1, "done")]


def test_two_outputs_change_in_one_image_and_the_outputs_of_others_stay() -> None:
    rig = ready(channel=DOUBLE, sensed=0)
    rig.run(0, 0b000001, 0b000010)
    rig.go(1.0)
    assert rig.switched == [lines(0, ALL), lines(1, ALL & ~1), lines(2, ALL & ~2)]
    assert rig.master.outputs == lines(2, ALL & ~2)


def test_a_pulse_ends_after_its_time() -> None:
    rig = ready(channel=BISTABLE)
    rig.run(1, 0, 1)
    rig.go(1.0)
    assert rig.results == [(1, "done")]
    assert rig.master.outputs == 0
    assert pulses(rig) == [PULSE] * 3


@pytest.mark.parametrize("event", [Cancel(1, None, ""), Stop(1), Quit()])
def test_a_pulse_ends_after_its_time_whatever_is_asked_meanwhile(event: Any) -> None:
    rig = ready(channel=BISTABLE)
    rig.run(1)
    rig.go(TICK)
    rig.do(event) if isinstance(event, Quit) else rig.send(event)
    assert not rig.core.ended
    rig.go(0.2)
    assert pulses(rig) == [PULSE]
    assert rig.core.ended == isinstance(event, Quit)


def test_a_pulse_whose_sync_is_under_way_when_the_end_is_requested_ends_before_the_executor() -> None:
    rig = ready(channel=BISTABLE)
    rig.master.slow_sync = True
    rig.run(1)
    rig.do(Quit())
    rig.master.slow_sync = False
    rig.master.leave(rig.now)
    rig.send(Alive())  # an event before the next tick
    assert (rig.master.outputs, rig.core.ended) == (lines(1, 0), False)
    rig.go(0.2)
    assert (pulses(rig), rig.core.ended) == ([PULSE], True)


@pytest.mark.parametrize("lost", [0b000111, 0b111000, ALL])
def test_a_pulse_ends_after_its_time_though_a_board_is_lost_which_may_still_hear(lost: int) -> None:
    rig = ready(channel=BISTABLE)
    rig.run(1)
    rig.go(TICK)
    rig.master.fail(LOST, lost=lost)
    rig.go(0.2)
    assert rig.mode == "fault"
    assert pulses(rig) == [PULSE]


def test_boards_are_booted_only_when_no_pulse_is_on() -> None:
    rig = ready(channel=BISTABLE)
    rig.run(1)
    rig.go(TICK)
    rig.send(Stop(1))
    rig.send(Reset(2, rig.epoch))
    boots = rig.master.booted
    rig.go(TICK)
    assert (rig.mode, rig.master.booted) == ("starting", boots)
    rig.go(0.2)
    assert (rig.mode, rig.master.booted, pulses(rig)) == ("ready", boots + 1, [PULSE])


def test_a_pulse_that_a_start_finds_is_ended_at_once() -> None:
    rig = Rig(channel=BISTABLE, sensed=0)
    rig.master.outputs = lines(0b1, 0b10)
    rig.connect()
    rig.go(3 * TICK)
    assert (rig.mode, rig.master.outputs, rig.states) == ("ready", 0, 1)
    assert unpack(rig.snapshot.homing) == ALL & ~0b11, "which output was on told the state"


def test_all_actuators_rest_after_a_start_that_ended_a_pulse_while_boards_booted() -> None:
    rig = Rig(channel=BISTABLE, sensed=0, rest=0.3)
    rig.master.outputs, rig.master.boots_long = lines(0b1, 0), True
    rig.connect()
    rig.go(3 * TICK)
    assert (rig.mode, rig.master.outputs) == ("starting", 0)
    rig.master.boots_long = False
    rig.go(2 * TICK)
    began = rig.now
    rig.run(0b10, homed=0b10)
    rig.go(1.0)
    assert rig.results == [(1, "done")]
    assert rig.master.commits[0][0] - began >= TRAVEL + 0.3 - 3 * TICK


def test_two_outputs_that_are_both_on_go_off_and_tell_nothing() -> None:
    rig = Rig(channel=DOUBLE, sensed=0)
    rig.master.outputs = lines(0b11, 0b10)
    rig.connect()
    rig.go(3 * TICK)
    assert (rig.mode, rig.master.outputs) == ("ready", lines(0b01, 0))
    assert unpack(rig.snapshot.homing) == ALL & ~1


def test_a_boot_keeps_known_states_but_not_those_of_a_board_that_started_anew() -> None:
    rig = ready(channel=BISTABLE, sensed=0)
    rig.run(0b010010)
    rig.go(0.5)
    rig.send(Stop(1))
    rig.master.boots = (0, 1)
    rig.send(Reset(2, rig.epoch))
    rig.go(0.2)
    assert (rig.mode, rig.states, unpack(rig.snapshot.homing)) == ("ready", 0b010010, 0b111000)


def test_a_pulse_with_an_unknown_sync_leaves_the_state_unknown() -> None:
    rig = ready(channel=BISTABLE, sensed=0)
    rig.run(0)
    rig.go(0.5)
    rig.master.slow_sync = True
    rig.run(1)
    rig.go(TICK)
    rig.master.fail(LOST, lost=ALL)
    rig.master.committing = False
    rig.go(TICK)
    rig.master.back, rig.master.slow_sync = True, False
    rig.go(1.5)
    assert (rig.mode, unpack(rig.snapshot.homing)) == ("ready", 1)
    assert rig.journal.counts == [0] * 6


def test_a_switch_of_unknown_outcome_is_not_counted_after_a_kill() -> None:
    rig = Rig(channel=BISTABLE, sensed=0)
    rig.journal.intend(0b000001, 0)  # of the process before: the states that the next one guesses
    rig.connect()
    rig.go(3 * TICK)
    assert (rig.mode, unpack(rig.snapshot.homing)) == ("ready", ALL)
    assert rig.journal.counts == [0] * 6


def test_the_arm_is_ready_with_a_pulse_longer_than_the_travel() -> None:
    rig = ready(channel={**BISTABLE, "pulse": 4 * TRAVEL})
    rig.run(1, 0)
    rig.go(1.0)
    assert rig.results == [(1, "done")]
    assert [mask for _, mask in rig.master.left] == [lines(1, 0), lines(1, 1), lines(0, 1)], "the other one takes over"


def test_a_pulse_no_longer_counts_a_tenth_of_a_second_after_its_end() -> None:
    rig = ready(channel=BISTABLE)
    rig.run(1)
    [(began, _)] = rig.master.left
    over = began + PULSE + LATE
    assert rig.core.motion.actuation.pulsing(math.nextafter(over, 0.0))
    assert not rig.core.motion.actuation.pulsing(over)


def test_a_pulse_that_was_given_up_leaves_the_state_known() -> None:
    rig = ready(channel=BISTABLE, sensed=0)
    rig.run(0)
    rig.go(0.5)
    rig.master.slow_rpdos = True
    rig.run(1)
    rig.send(Stop(1))
    rig.master.slow_rpdos = False
    rig.send(Reset(2, rig.epoch))
    rig.go(0.2)
    assert (rig.mode, rig.states, unpack(rig.snapshot.homing)) == ("ready", 0, 0)


@settings(max_examples=60, deadline=None)
@given(data=st.data(), pulse=st.sampled_from([0.01, 0.03, 0.05, 0.2]), sensed=st.sampled_from([0, ALL]))
def test_whatever_is_asked_no_pulse_is_longer_than_asked_by_a_period(
    data: st.DataObject, pulse: float, sensed: int
) -> None:
    rig = ready(channel={**BISTABLE, "pulse": pulse}, sensed=sensed)
    verbs = st.sampled_from(["run", "run", "run", "go", "go", "cancel", "halt", "reset", "lost", "busy"])
    for request, verb in enumerate(data.draw(st.lists(verbs, max_size=20))):
        match verb:
            case "run":
                rig.run(*data.draw(st.lists(st.integers(0, ALL), min_size=1, max_size=3)), step=0.05)
            case "cancel":
                rig.send(Cancel(request, None, ""))
            case "halt":
                rig.send(Stop(request))
            case "reset":
                rig.send(Reset(request, rig.epoch))
            case "lost":
                rig.master.fail(LOST)
            case "busy":
                rig.run(data.draw(st.integers(0, ALL)))
        rig.go(data.draw(st.sampled_from([TICK, 0.03, 0.1])))
    rig.go(0.3)
    assert rig.master.outputs == 0
    on: dict[int, float] = {}
    for at, mask in rig.master.left:
        for line in range(2 * SIZE):
            if mask >> line & 1:
                began = on.pop(line, None)
                if began is None:
                    on[line] = at
                else:
                    assert at - began <= pulse + TICK + 1e-9


def test_the_end_of_a_pulse_that_the_bus_carries_late_is_told() -> None:
    rig = ready(channel=BISTABLE)
    rig.run(1)
    rig.go(TICK)
    rig.master.busy = True
    rig.go(0.3)
    assert rig.mode == "fault"
    assert [fault.code for fault in rig.snapshot.faults] == ["pulse-overdue"]
    rig.master.busy, rig.master.back = False, True
    rig.go(2.0)
    assert (rig.mode, rig.master.outputs, rig.snapshot.faults) == ("ready", 0, ())
