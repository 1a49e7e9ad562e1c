"""Plans as stages of motion programs: packing, times and marks."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from controller.motion.pacing import Staged
from controller.motion.plan import Plan
from controller.motion.program import delay_of, flatten, in_groups, pack_states, stages_from, unpack_states
from controller.motion.trajectory import Trajectory, through
from controller.program import pack, unpack

LEAD = 0.06
X, Y, Z = ([0, 0, 0], [1, 0, 0], [1, 1, 0])


def trajectory(*times: float, waypoints: list[int] | None = None) -> Trajectory:
    found = through(np.array(times), np.zeros((len(times), 2)), 0.01)
    return found if waypoints is None else replace(found, waypoints=np.array(waypoints))


def plan_of(trajectory: Trajectory, *transitions: list[list[int]]) -> Plan:
    staged = tuple(Staged(np.array(rows, dtype=np.uint8), 0.5) for rows in transitions)
    return Plan(trajectory, (), staged)


@given(st.lists(st.booleans(), min_size=1, max_size=40))
def test_states_are_packed_as_the_executor_unpacks_them(states: list[bool]) -> None:
    row = np.array(states, dtype=np.uint8)
    (packed,) = pack_states(row[None])
    bits = sum(1 << k for k, state in enumerate(states) if state)
    assert (unpack(packed), pack(bits, len(states))) == (bits, packed)
    np.testing.assert_array_equal(unpack_states(packed, len(states)), row)


def test_the_last_stage_settles_at_the_points_time() -> None:
    plan = plan_of(trajectory(0.0, 1.0), [X], [Y, Z])
    first, second = stages_from(plan, 0, None, LEAD, 0.1, -np.inf, pack_states)
    assert [stage.at for stage in first.stages] == pytest.approx([0.1 - LEAD])
    assert [stage.at for stage in second.stages] == pytest.approx([1.1 - 2 * LEAD, 1.1 - LEAD])
    assert [(stage.mark, stage.settled) for stage in second.stages] == [(-1, 0.0), (1, pytest.approx(1.1))]
    assert second.deviation == 0.5


def test_stages_never_begin_before_the_stage_before() -> None:
    plan = plan_of(trajectory(0.0, 0.1), [X], [Y, Z, X])
    stages = flatten(list(stages_from(plan, 0, None, LEAD, 0.0, -np.inf, pack_states)))
    assert [stage.at for stage in stages] == pytest.approx([-0.06, -0.06, -0.02, 0.04])


def test_points_between_waypoints_at_which_the_arm_holds_are_left_out() -> None:
    plan = plan_of(trajectory(0, 1, 2, 3, 4, waypoints=[0, 4]), [X], [X], [Y], [Y], [Y])
    found = list(stages_from(plan, 0, None, LEAD, 0.0, -np.inf, pack_states))
    assert [reached.point for reached in found] == [0, 2, 4], "the last is a waypoint"
    later = list(stages_from(plan, 1, found[0].end, LEAD, 0.0, 0.0, pack_states))
    assert [reached.point for reached in later] == [2, 4]


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
