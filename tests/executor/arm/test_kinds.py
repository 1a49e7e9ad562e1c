"""Kinds of actuators: outputs for states, states from outputs, and what end-stops tell."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from hyperbit.controller.executor.arm.kinds import Ends, Kinds
from hyperbit.drivers.canopen.wiring import BusWiring, Channel, Interlock, Timing, Wiring

CAN0 = BusWiring("can0", "virtual", "x")


def kinds(*channels: Channel, interlocks: tuple[Interlock, ...] = ()) -> Kinds:
    return Kinds(Wiring((CAN0,), channels, interlocks=interlocks), Timing())


@st.composite
def wirings(draw: st.DrawFn) -> Kinds:
    channels = []
    for k in range(draw(st.integers(1, 5))):
        paired, ends = draw(st.booleans()), draw(st.tuples(st.booleans(), st.booleans()))
        pulse = 0.05 if paired and draw(st.booleans()) else None
        off, extended, contracted = 2 * k + 1, 2 * k if ends[0] else None, 2 * k + 1 if ends[1] else None
        channels.append(Channel(f"{k}", "can0", 1, 2 * k, extended, off if paired else None, contracted, pulse=pulse))
    return kinds(*channels)


@given(kinds=wirings(), data=st.data())
def test_both_outputs_of_a_pair_are_never_on_and_tell_the_state(kinds: Kinds, data: st.DataObject) -> None:
    states, on, before = (data.draw(st.integers(0, kinds.everything)) for _ in range(3))
    outputs = kinds.outputs(states, on & kinds.paired)
    extending, contracting = kinds.on(outputs)
    assert not extending & contracting
    assert extending | contracting == on & kinds.paired
    told = on | ~kinds.paired
    assert (kinds.states(outputs, before) ^ states) & told & kinds.everything == 0
    assert (kinds.states(outputs, before) ^ before) & ~told == 0
    assert outputs & ~kinds.lines(kinds.paired) == states & ~kinds.paired


@given(kinds=wirings(), states=st.integers(0, 31), commanded=st.integers(0, 31))
def test_end_stops_at_rest_tell_the_state(kinds: Kinds, states: int, commanded: int) -> None:
    states, commanded = states & kinds.everything, commanded & kinds.everything
    ends = Ends(states & kinds.ends_extended, ~states & kinds.ends_contracted)
    assert kinds.definite(ends) == kinds.sensed
    assert kinds.measured(ends, commanded) == (states & kinds.sensed) | (commanded & ~kinds.sensed)


def test_between_its_ends_and_at_both_at_once_an_actuator_with_two_end_stops_is_as_commanded() -> None:
    both = kinds(Channel("a", "can0", 1, 0, 0, None, 1))
    for ends in (Ends(0, 0), Ends(1, 1)):
        assert both.definite(ends) == 0
        assert [both.measured(ends, commanded) for commanded in (0, 1)] == [0, 1]


def test_inputs_are_end_stops_then_interlocks() -> None:
    stop, air = Interlock("stop", "can0", 9, 0), Interlock("air", "can0", 9, 1)
    arm = kinds(Channel("a", "can0", 1, 0, None), Channel("b", "can0", 1, 1, 3, None, 4), interlocks=(stop, air))
    assert arm.ends(0b00110) == Ends(0b10, 0b10)
    assert arm.ends(0b00010) == Ends(0b10, 0)
    assert arm.open(0b01000, known=0b11111) == [air]
    assert arm.open(0b00000, known=0b00111) == []
    assert arm.open(0b11000, known=0b11111) == []


def test_an_arm_of_single_outputs_has_its_states_as_outputs() -> None:
    arm = kinds(*(Channel(f"{k}", "can0", 1, k, None) for k in range(3)))
    assert (arm.outputs(0b101, 0), arm.states(0b101, 0), arm.on(0b101)) == (0b101, 0b101, (0, 0))


def test_times_are_the_actuators_or_else_the_arms() -> None:
    arm = kinds(
        Channel("a", "can0", 1, 0, None, travel=(0.2, 0.1), settle_margin=0.5), Channel("b", "can0", 1, 1, None)
    )
    assert (arm.travel, arm.margin) == (((0.2, 0.1), (0.05, 0.05)), (0.5, 0.03))
    assert [max(travel) for travel in arm.travel] == [0.2, 0.05]
