"""Stages from other actuator states than planned, within the inrush bound."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hyperbit.controller.manipulator.manipulator import Manipulator
from hyperbit.controller.motion.stages.pacing import Pace, Stager
from hyperbit.controller.motion.stages.program import is_configuration, module_step, restage
from tests.arms import paper_arm, spatial_arm

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
