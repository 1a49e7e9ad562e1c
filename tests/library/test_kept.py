"""What the library keeps is its own, and what it returns is read-only."""

import pickle

import numpy as np
import pytest

import hyperbit as hb
from hyperbit.controller.armfile.strict import InputFaults


@pytest.fixture(scope="module")
def arm() -> hb.Arm:
    return hb.Arm([hb.vgt(width=0.2, lengths=(0.2, 0.25), count=4)])


def test_goals_made_of_one_array_keep_their_places():
    position, goals = np.array([0.1, 0.8]), []
    for _ in range(3):
        goals.append(hb.Goal(position))
        position += 0.01
    assert [float(goal.target[0]) for goal in goals] == pytest.approx([0.1, 0.11, 0.12])
    with pytest.raises(ValueError, match="read-only"):
        goals[0].target[0] = np.nan


def test_home_and_solutions_are_read_only(arm):
    for array in (arm.home, hb.Solver(arm).solve((0.0, 0.9)).configuration, hb.Solver(arm).solve((0.0, 0.9)).tip):
        with pytest.raises(ValueError, match="read-only"):
            array[:1] = 7
    path = hb.Solver(arm).follow([arm.position("2222")])
    with pytest.raises(ValueError, match="read-only"):
        path.positions[0] = 7


def test_actuator_states_are_0_or_1(arm):
    states = np.zeros(12)
    states[0] = 0.9999999999999999
    with pytest.raises(hb.ConfigurationError, match=r"state is 0 or 1, got .*0\.9999999999999999.*1\.left"):
        arm.configuration(states)
    for wrong in (-0.6, 0.4, 2):
        with pytest.raises(hb.ConfigurationError, match="is 0 or 1"):
            arm.configuration(np.full(12, wrong))
    assert arm.format(arm.configuration(np.zeros(12))) == arm.format(arm.configuration([False] * 12)) == "0000"


def test_weights_and_obstacles_are_copied(arm):
    weights, centre = np.ones(12), np.array([5.0, 5.0])
    disc = hb.Disc(centre, 0.1)
    ik = hb.Solver(arm, obstacles=[disc], weights=weights)
    weights[:], centre[:] = 5, 0
    found = ik.solve((0.0, 0.9))
    assert found.cost == found.switches
    assert np.asarray(disc.centre).tolist() == [5.0, 5.0]


def test_masked_numbers_and_degrees_are_refused():
    with pytest.raises(hb.GoalError, match="position: finite numbers"):
        hb.Goal(np.ma.array([0.5, 2.9], mask=[True, False]))
    with pytest.raises(hb.GoalError, match=r"orientation: .* in radians, -50 degrees are -0\.8727"):
        hb.Goal((0.5, 2.9), orientation=-50)


@pytest.mark.parametrize(
    "error",
    [hb.ArmError(["a: b", "c: d"], "arm.yaml", [1, None]), hb.GoalError("no"), InputFaults("arm.yaml", ["a: b"], [3])],
)
def test_errors_can_be_pickled(error):
    again = pickle.loads(pickle.dumps(error))
    assert (type(again), str(again)) == (type(error), str(error))
    assert getattr(again, "faults", None) == getattr(error, "faults", None)


def test_what_works_at_run_time_is_accepted(arm):
    goals = np.array([[0.0, 0.9], [0.05, 0.88]])
    assert len(hb.Solver(arm).solve_many(goals)) == 2
    assert hb.Goal((0.0, 0.9), tolerance=np.float32(0.01)).tolerance == pytest.approx(0.01)
    assert arm.lock({"1.left": "extended"}).locked == {"1.left": "extended"}
