"""When which waypoint is due."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from controller.daemon.events import Planned
from controller.daemon.execution import Execution, start
from controller.motion.trajectory import Trajectory, through
from tests.daemon.rig import planned

LEAD = 0.06


def execution(waypoints: int = 3, step: float = 1.0) -> Execution:
    """Waypoints at 100, 101, ... of the loop's clock."""
    plan = planned(*[(k % 8, 0) for k in range(waypoints)], step=step)
    return Execution(Planned(1, print, "a", plan), start=100.0, lead=LEAD)


def test_a_waypoint_is_due_the_lead_before_its_time() -> None:
    it = execution()
    assert it.due(100 - LEAD - 1e-6) is None
    assert it.due(100 - LEAD + 1e-6) == (0, 0)


def test_the_latest_is_due_and_nothing_older_after_it() -> None:
    it = execution()
    assert it.due(101.5) == (1, 0)
    it.switched(1, 0, 4, 1, 101.5, 0.05)
    assert it.due(101.5) is None
    assert (it.waypoint, it.switches, it.last) == (1, 4, False)
    assert it.due(1e9) == (2, 0)


def test_settled_at_its_time_or_after_the_travel() -> None:
    it = execution()
    it.switched(0, 0, 1, 1, 100 - LEAD, 0.05)
    assert it.settled_at == 100
    it.switched(1, 0, 1, 1, 101.5, 0.05)
    assert it.settled_at == pytest.approx(101.55)


@given(st.lists(st.floats(0, 30), max_size=60), st.integers(1, 20), st.floats(0.06, 5))
def test_no_waypoint_twice_and_never_backwards(moments: list[float], waypoints: int, step: float) -> None:
    it, switched = execution(waypoints, step), []
    for now in np.cumsum([95, *moments]):
        due, stage = it.due(float(now)) or (None, 0)
        if due is not None:
            assert it.start + due * step <= now + LEAD + 1e-6
            it.switched(due, stage, 0, 0, float(now), 0.05)
            switched.append(due)
        later = it.waypoint + 1
        assert later == waypoints or it.start + later * step > now + LEAD - 1e-6, "nothing due is left waiting"
    assert switched == sorted(set(switched))


def trajectory(stamp: float | None, first: float) -> Trajectory:
    return through(np.array([first, first + 1]), np.zeros((2, 2)), 0.002, stamp)


def test_a_stamp_is_turned_into_the_loops_clock_once() -> None:
    assert start(trajectory(5000.0, 0.0), LEAD, monotonic=100.0, unix=4990.0) == 110.0


def test_without_a_stamp_the_first_waypoint_has_the_time_it_needs() -> None:
    assert start(trajectory(None, 0.0), LEAD, monotonic=100.0, unix=5000.0) == 100 + LEAD
    assert start(trajectory(None, 0.02), LEAD, monotonic=100.0, unix=5000.0) == 100 + LEAD - 0.02
    assert start(trajectory(None, 3.0), LEAD, monotonic=100.0, unix=5000.0) == 100
