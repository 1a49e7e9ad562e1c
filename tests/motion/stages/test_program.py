"""Stages of motion programs: packing, groups and delays."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hyperbit.controller.motion.stages.program import delay_of, in_groups, pack_states, unpack_states
from hyperbit.controller.motion.trajectory import Trajectory, through
from hyperbit.controller.program import pack, unpack


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
