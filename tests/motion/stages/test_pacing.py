"""The number of stages of a transition in the available time."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hyperbit.controller.motion.plans.point_by_point import PointByPoint
from hyperbit.controller.motion.plans.transitions import TransitionPlanner
from hyperbit.controller.motion.stages.pacing import MOST_STAGES, Infeasible, Pace, Stager
from hyperbit.controller.motion.stages.transition import build_transition
from hyperbit.controller.motion.trajectory import through
from hyperbit.controller.refusals.codes import INVALID_GOAL
from hyperbit.controller.refusals.refusal import Refusal
from tests.arms import paper_arm

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
    assert str(caught.value).startswith("waypoints[0] to waypoints[1]: 0.1 s, ")
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
