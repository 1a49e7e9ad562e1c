"""The reduced arm of locked actuators, compared with the whole arm configuration by configuration."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hyperbit.controller.manipulator.joints import revolute
from hyperbit.controller.manipulator.locked import lock_actuators, none_locked, require_states, transferred
from hyperbit.controller.manipulator.manipulator import Manipulator
from tests.arms import every_configuration, paper_arm, short_arms


@st.composite
def locked_arms(draw: st.DrawFn) -> tuple[Manipulator, np.ndarray]:
    """An arm, and locked states of some of its actuators as one of its configurations has them."""
    arm = draw(short_arms(most=3))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    states = arm.actuator_states(rng.integers(0, arm.states)).astype(np.int8)
    return arm, np.where(rng.random(len(states)) < draw(st.floats(0, 1)), states, -1).astype(np.int8)


@given(locked_arms())
def test_what_is_left_are_the_configurations_with_the_held_states_and_their_tips(case):
    arm, locked = case
    require_states(arm, locked)
    reduced = lock_actuators(arm, locked)
    whole = every_configuration(arm)
    states = np.array([arm.actuator_states(c) for c in whole])
    permitted = ((locked < 0) | (states == locked)).all(axis=1)
    reduced_rows = every_configuration(reduced)
    assert reduced.actuators == arm.actuators
    assert np.array_equal([reduced.actuator_states(c) for c in reduced_rows], states[permitted])
    assert np.array_equal([transferred(c, reduced, arm) for c in reduced_rows], whole[permitted])
    assert np.array_equal([transferred(c, arm, reduced) for c in whole[permitted]], reduced_rows)
    assert np.allclose(reduced.tips(reduced_rows), arm.tips(whole[permitted]))


def test_nothing_held_is_the_arm_itself():
    arm = paper_arm(2)
    assert lock_actuators(arm, none_locked(arm)) is arm


def test_a_configuration_that_is_left_out_cannot_be_carried():
    arm = paper_arm(2)
    reduced = lock_actuators(arm, np.array([1, -1, -1, -1, -1, -1], dtype=np.int8))
    with pytest.raises(ValueError, match=r"module 1 has no state in which left is contracted$"):
        transferred(np.zeros(2, dtype=np.int64), arm, reduced)


@pytest.mark.parametrize("check", [lock_actuators, require_states])
def test_a_module_that_has_no_state_left_is_named(check):
    motor = Manipulator([revolute((0, 0, 1), [0.0, 0.1, 0.2], np.eye(4))])  # spelled 00, 01, 11
    with pytest.raises(ValueError, match="module 1 has no state in which 1 is extended and 2 is contracted"):
        check(motor, np.array([1, 0], dtype=np.int8))


@pytest.mark.parametrize("check", [lock_actuators, require_states])
def test_locked_states_of_a_wrong_number_are_refused(check):
    with pytest.raises(ValueError, match="6 actuators, got locked states of shape"):
        check(paper_arm(2), np.zeros(3, dtype=np.int8))
