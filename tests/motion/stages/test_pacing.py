"""The number of stages in the available time, stages of motion programs, and stages from other states than planned."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hyperbit.controller.manipulator.manipulator import Manipulator
from hyperbit.controller.motion.plans.point_by_point import PointByPoint
from hyperbit.controller.motion.plans.transitions import TransitionPlanner
from hyperbit.controller.motion.stages.pacing import MOST_STAGES, Infeasible, Pace, Stager
from hyperbit.controller.motion.stages.program import (
    delay_of,
    in_groups,
    is_configuration,
    module_step,
    pack_states,
    restage,
    unpack_states,
)
from hyperbit.controller.motion.stages.transition import build_transition
from hyperbit.controller.motion.trajectory import Trajectory, through
from hyperbit.controller.program import pack, unpack
from hyperbit.controller.refusals.codes import INVALID_GOAL
from hyperbit.controller.refusals.refusal import Refusal
from tests.arms import paper_arm, spatial_arm

LEAD = 0.06
ARM = paper_arm(4)
ZERO, FAR = np.zeros(4, dtype=np.int64), np.array([7, 7, 7, 0])  # nine switches apart
configurations = st.lists(st.integers(0, 7), min_size=4, max_size=4).map(np.array)


@given(configurations, configurations, st.integers(1, 12), st.floats(0.0, 1.0), st.floats(0.0, 0.3))
def test_in_time_within_the_bound_or_refused(before, after, inrush, available, rest):
    pace, n = Pace(LEAD, inrush, rest), ARM.switches(before, after)
    if n > 1 and available < pace.needed(n) - 1e-8:
        with pytest.raises(Infeasible, match=f"{n} switches, at most {inrush} at once, need"):
            Stager(ARM, pace).staged(before, after, available)
    elif available >= pace.shortest:
        stages = Stager(ARM, pace).staged(before, after, available).stages
        assert len(stages) * LEAD + rest <= available + 1e-6
        assert len(stages) <= max(MOST_STAGES, -(-n // inrush))
        every = np.vstack([ARM.actuator_states(before), stages]).astype(int)
        switched = np.abs(np.diff(every, axis=0))
        assert (switched.sum(axis=1) <= inrush).all()
        assert (switched.sum(axis=0) <= 1).all(), "twice in one transition"
        assert stages[-1].tolist() == ARM.actuator_states(after).tolist()


def test_without_a_bound_all_at_once():
    staged = Stager(ARM, Pace(LEAD)).staged(ZERO, FAR, 10.0)
    assert staged.stages.tolist() == [ARM.actuator_states(FAR).tolist()]
    transition = build_transition(ARM, ZERO, FAR)
    assert staged.deviation == transition.greatest(transition.masks([]), np.arange(9))


def test_more_time_strays_less_and_nothing_to_do_is_one_stage():
    pace = replace(Pace(LEAD), inrush=3)
    short, wide = (Stager(ARM, pace).staged(ZERO, FAR, t) for t in (3 * LEAD, 8 * LEAD))
    assert len(short.stages) == 3 < len(wide.stages)
    assert wide.deviation < short.deviation < Stager(ARM, Pace(LEAD)).staged(ZERO, FAR).deviation
    still = Stager(ARM, pace).staged(FAR, FAR, LEAD)
    assert (still.stages.tolist(), still.deviation) == ([ARM.actuator_states(FAR).tolist()], 0.0)


def test_a_goal_too_fast_is_refused_naming_the_pair(solver, manipulator):
    positions = np.array([(0.55, 2.9), (3.0, 0.7)])
    fast = through(np.array([0.0, 0.1]), positions, 0.002)
    with pytest.raises(Refusal) as caught:
        PointByPoint(TransitionPlanner(solver, fast, Pace(LEAD, 1)), "ipop-previous").plan(ZERO.repeat(4))
    assert caught.value.code == INVALID_GOAL
    assert str(caught.value).startswith("waypoint 1 to 2: 0.1 s, ")
    slow = replace(fast, times=np.array([0.0, 5.0]))
    found = PointByPoint(TransitionPlanner(solver, slow, Pace(LEAD, 1)), "ipop-previous").plan(ZERO.repeat(4))
    assert [len(t.stages) for t in found.transitions] == [s.switches for s in found.solutions]


def test_better_plans_that_do_not_fit_are_left_out(solver):
    pace, near, far = Pace(LEAD, 2), ZERO.repeat(4), np.array([7] * 16)
    tips = solver.manipulator.tips([near] * 3)[:, :2, 3]
    planner = TransitionPlanner(solver, through(np.arange(3) * 0.3, tips, 10.0), pace)
    still = PointByPoint(planner, "minimum-switch").plan(near)
    slight = near.copy()
    slight[0] = 1
    better = still.improved(planner, 1, [slight, far])
    assert [s.configuration.tolist() for s in better.solutions] == [c.tolist() for c in (near, slight, near)]
    assert better.actuator_states.tolist() == [
        solver.manipulator.actuator_states(s.configuration).tolist() for s in better.solutions
    ]
    assert still.improved(planner, 1, [far, far]) is still


def trajectory(*times: float) -> Trajectory:
    return through(np.array(times), np.zeros((len(times), 2)), 0.01)


@given(st.lists(st.booleans(), min_size=1, max_size=40))
def test_states_are_packed_as_the_executor_unpacks_them(states: list[bool]) -> None:
    row = np.array(states, dtype=np.uint8)
    (packed,) = pack_states(row[None])
    bits = sum(1 << k for k, state in enumerate(states) if state)
    assert (unpack(packed), pack(bits, len(states))) == (bits, packed)
    np.testing.assert_array_equal(unpack_states(packed, len(states)), row)


@pytest.mark.parametrize(("first", "needed", "delay"), [(0.0, 0.06, 0.06), (0.1, 0.06, 0.0), (0.05, 0.5, 0.45)])
def test_a_trajectory_begins_as_late_as_its_first_point_needs(first: float, needed: float, delay: float) -> None:
    assert delay_of(trajectory(first, 9.0), needed) == pytest.approx(delay)


@given(st.lists(st.integers(0, 1), min_size=6, max_size=6), st.integers(1, 6))
def test_actuators_switch_in_groups(target: list[int], most: int) -> None:
    states, end = np.zeros(6, dtype=np.uint8), np.array(target, dtype=np.uint8)
    stages = in_groups(states, end, most)
    rows = np.vstack([states, stages])
    assert (np.abs(np.diff(rows.astype(int), axis=0)).sum(axis=1) <= most).all()
    assert stages[-1].tolist() == target
    assert len(stages) == max(-(-sum(target) // most), 1)


ARMS = [paper_arm(4), spatial_arm(4)]  # the second's modules have 6 of 8 codes


@given(st.data(), st.sampled_from(ARMS), st.integers(1, 5))
def test_from_anywhere_within_the_bound_through_configurations(data: st.DataObject, arm: Manipulator, most: int):
    here, before, after = (np.array([data.draw(st.integers(0, k - 1)) for k in arm.states]) for _ in range(3))
    planned = Stager(arm, Pace(0.06, most)).staged(before, after).stages
    states = arm.actuator_states(here)
    for stage in restage(arm, states, planned, most):
        assert np.count_nonzero(stage != states) <= most
        assert is_configuration(arm, stage)
        states = stage
    np.testing.assert_array_equal(states, planned[-1])
    np.testing.assert_array_equal(restage(arm, arm.actuator_states(before), planned, most), planned)


def test_what_has_its_last_state_already_stays():
    arm = ARMS[0]
    planned = Stager(arm, Pace(0.06, 2)).staged([0, 0, 0, 0], [7, 7, 0, 0]).stages
    ways = restage(arm, arm.actuator_states([7, 0, 0, 0]), planned, 2)
    assert np.count_nonzero(np.diff(np.vstack([arm.actuator_states([7, 0, 0, 0]), ways]).astype(int), axis=0)) == 3


def test_a_module_goes_round_the_codes_it_does_not_have():
    codes = np.array([[0, 0], [0, 1], [1, 0], [1, 1]], dtype=np.uint8)
    assert module_step(codes[:3], codes[1], codes[2], 1).tolist() == [0, 0]
    with pytest.raises(ValueError, match=r"no path from \[0, 0\] to \[1, 1\] with 1 actuators at once"):
        module_step(codes[[0, 3]], codes[0], codes[3], 1)
