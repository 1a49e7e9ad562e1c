"""The arm that is left when actuators are held, compared with the whole arm's configurations one by one."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from controller.manipulator.held import carried, free, hold
from controller.manipulator.joints import revolute
from controller.manipulator.manipulator import Manipulator
from tests.arms import every_configuration, paper_arm, short_arms


@st.composite
def held_arms(draw: st.DrawFn) -> tuple[Manipulator, np.ndarray]:
    """An arm, and some of its actuators held as one of its configurations has them."""
    arm = draw(short_arms(most=3))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    states = arm.actuator_states(rng.integers(0, arm.states)).astype(np.int8)
    return arm, np.where(rng.random(len(states)) < draw(st.floats(0, 1)), states, -1).astype(np.int8)


@given(held_arms())
def test_what_is_left_are_the_configurations_with_the_held_states_and_their_tips(case):
    arm, held = case
    left = hold(arm, held)
    whole = every_configuration(arm)
    states = np.array([arm.actuator_states(c) for c in whole])
    kept = ((held < 0) | (states == held)).all(axis=1)
    reduced = every_configuration(left)
    assert left.actuators == arm.actuators
    assert np.array_equal([left.actuator_states(c) for c in reduced], states[kept])
    assert np.array_equal([carried(c, left, arm) for c in reduced], whole[kept])
    assert np.array_equal([carried(c, arm, left) for c in whole[kept]], reduced)
    assert np.allclose(left.tips(reduced), arm.tips(whole[kept]))


def test_nothing_held_is_the_arm_itself():
    arm = paper_arm(2)
    assert hold(arm, free(arm)) is arm


def test_a_configuration_that_is_left_out_cannot_be_carried():
    arm = paper_arm(2)
    left = hold(arm, np.array([1, -1, -1, -1, -1, -1], dtype=np.int8))
    with pytest.raises(ValueError, match="module 1 has no configuration"):
        carried(np.zeros(2, dtype=np.int64), arm, left)


def test_a_module_that_has_no_state_left_is_named():
    motor = Manipulator([revolute((0, 0, 1), [0.0, 0.1, 0.2], np.eye(4))])  # spelled 00, 01, 11
    with pytest.raises(ValueError, match="module 1 has no state in which 1 is extended and 2 is contracted"):
        hold(motor, np.array([1, 0], dtype=np.int8))


def test_held_states_of_a_wrong_number_are_refused():
    with pytest.raises(ValueError, match="6 actuators, got held states of shape"):
        hold(paper_arm(2), np.zeros(3, dtype=np.int8))
