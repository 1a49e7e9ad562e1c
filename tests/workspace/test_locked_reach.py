"""Reach with locked actuators, against separate mappings and enumeration."""

import math

import numpy as np
import pytest

from hyperbit.controller.manipulator.locked import lock_actuators
from hyperbit.controller.manipulator.manipulator import Manipulator
from hyperbit.controller.workspace.locked_reach import LockChoices, choices, reach_when_locked
from hyperbit.controller.workspace.mapping import map_densities
from tests.arms import every_configuration, paper_arm, spatial_arm

TOLERANCE = 0.02
ARMS = {"planar": paper_arm(4), "spatial": spatial_arm(4)}


@pytest.fixture(params=ARMS)
def arm(request) -> Manipulator:
    return ARMS[request.param]


def test_one_lock_tries_every_actuator_in_both_states(arm):
    found = reach_when_locked(arm, map_densities(arm, 0.02, 1 << 16), TOLERANCE, LockChoices(1, 5))
    assert found.every
    assert len(found.choices) + found.impossible == 2 * len(arm.actuators)
    assert all((one.locked >= 0).sum() == 1 for one in found.choices)
    assert all(one.reach <= 1.05 * found.free.reach for one in found.choices)
    for figure in ("reach", "covered", "log10_redundancy"):
        values = [getattr(one, figure) for one in found.choices]
        assert getattr(found.worst(figure), figure) == min(values)
        assert found.mean(figure) == pytest.approx(np.mean(values))


def test_each_choice_is_reckoned_as_an_arm_of_its_own(arm):
    """Against pixels with the tips of all configurations: only the pixels limit the accuracy."""
    found = reach_when_locked(arm, map_densities(arm, 0.02, 1 << 16), TOLERANCE, LockChoices(1, 5))
    for one in (found.free, *found.choices[::5]):
        reduced = lock_actuators(arm, one.locked)
        tips = reduced.tips(every_configuration(reduced))[:, :3, 3]
        pixels = np.unique(np.round((tips - found.reference) / found.pixel).astype(int), axis=0)
        assert one.reach / found.pixel**arm.dimension == pytest.approx(len(pixels), rel=0.15)


def test_counts_add_up_to_all_configurations(arm):
    found = reach_when_locked(arm, map_densities(arm, 0.02, 1 << 16), TOLERANCE, LockChoices(1, 5))
    ball = math.pi * TOLERANCE**2 if arm.planar else 4 / 3 * math.pi * TOLERANCE**3
    total = np.exp(found.free_counts).sum() * found.pixel**arm.dimension / ball
    assert total == pytest.approx(math.prod(arm.states.tolist()))
    assert (found.least_counts <= found.free_counts + 1e-9).mean() > 0.95  # centroids may change pixels


def test_more_locks_are_sampled_and_the_same_for_a_seed():
    arm = ARMS["planar"]
    first, every = choices(arm, 2, 20, seed=3)
    again, _ = choices(arm, 2, 20, seed=3)
    assert not every
    assert len({held.tobytes() for held in first}) == 20
    assert [held.tolist() for held in first] == [held.tolist() for held in again]
    assert all((held >= 0).sum() == 2 for held in first)
    all_of_them, every = choices(arm, 2, 1000, seed=3)
    assert every
    assert len(all_of_them) == math.comb(12, 2) * 4


@pytest.mark.parametrize("locks", [0, 13])
def test_too_many_locks_are_refused(locks):
    arm = ARMS["planar"]
    with pytest.raises(ValueError, match="1 to 12 actuators can be locked"):
        reach_when_locked(arm, map_densities(arm, 0.05, 1 << 12), TOLERANCE, LockChoices(locks, 5))


def test_choices_that_leave_a_module_without_a_state_are_counted():
    arm = ARMS["spatial"]  # six states on three bits: 11x is none
    found = reach_when_locked(arm, map_densities(arm, 0.05, 1 << 14), TOLERANCE, LockChoices(2, 500))
    assert found.every
    assert found.impossible == 4  # one pair of states in each module
