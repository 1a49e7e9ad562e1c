"""The merit of an arm is that of trying all configurations, and leaves the cache alone."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import hyperbit as hb
from hyperbit.controller.design.judging import judge
from hyperbit.controller.design.merit import Effort, mean
from hyperbit.controller.workspace.cache import default_directory
from tests.design.brute import tried
from tests.design.making import random_arm, random_targets

ENOUGH = Effort(1e6, 1e6)


def compare(seed: int, bits: int, count: int) -> None:
    random = np.random.default_rng(seed)
    own = random_arm(random, bits)
    targets = random_targets(random, own, count)
    found = judge(own, targets, ENOUGH, stuck=True)
    truth = tried(own, targets, found.solutions)
    weights = np.array([target.weight for target in targets])
    switches = np.where(truth.reached, truth.switches, len(own.manipulator.actuators))
    assert found.reached == pytest.approx(weights @ truth.reached / weights.sum())
    assert found.switches == pytest.approx(weights @ switches / weights.sum())
    assert found.stuck == pytest.approx(weights @ truth.survives.mean(axis=(1, 2)) / weights.sum())
    assert found.stuck <= found.reached + 1e-12
    reached = [one is not None and one.within_tolerance for one in found.solutions]
    assert reached == truth.reached.tolist()
    taken = [one.switches for one in found.solutions if one is not None and one.within_tolerance]
    assert taken == truth.switches[truth.reached].tolist()


@settings(deadline=None, max_examples=20)
@given(st.integers(0, 10_000), st.integers(6, 9))
def test_merit_of_short_arms_is_that_of_brute_force(seed, bits):
    compare(seed, bits, 4)


@pytest.mark.parametrize("seed", [0, 1, 3])
def test_merit_by_searches_and_locked_searches_is_that_of_brute_force(seed):
    compare(seed, 16, 3)  # more configurations than are listed whole


def test_the_cache_is_not_used(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.delenv("CACHE_DIRECTORY", raising=False)
    arm = hb.Arm([hb.vgt(width=0.2, lengths=(0.2, 0.25), count=6)], tolerance=0.01)
    found = hb.merit(arm, [(0.1, 1.2), (0.3, 1.1), (0.0, 9.0)], stuck=False)
    assert found.reached == pytest.approx(2 / 3)
    assert found.solutions[2] is None or not found.solutions[2].within_tolerance
    assert not default_directory().exists()


def test_locks_and_obstacles_count():
    arm = hb.Arm([hb.vgt(width=0.2, lengths=(0.2, 0.25), count=4)], tolerance=0.05)
    targets = [(0.0, 0.9), hb.Goal((0.1, 0.85), orientation=-0.2, angle_tolerance=0.5)]
    free = hb.merit(arm, targets)
    walled = hb.merit(arm, targets, [hb.Disc((0.0, 0.9), 0.3)])
    held = hb.merit(arm.lock({"1.left": "extended"}), targets)
    assert (free.reached, walled.reached, walled.stuck) == (1.0, 0.0, 0.0)
    assert 0 < held.stuck < free.stuck <= 1
    assert all(arm.actuator_states(one.configuration)[0] == 1 for one in held.solutions)
    assert (walled.switches, walled.actuators) == (12, 12)


def test_work_for_a_miss_is_bounded():
    arm = hb.Arm([hb.vgt(width=0.2, lengths=(0.2, 0.25), count=14)], tolerance=1e-8)
    ik = hb.Solver(arm)
    short, long = (ik.solve((0.3, 2.5), effort=5, missed=missed).effort for missed in (10, 300))
    assert short < long / 2
    assert len(ik.solve_many([(0.3, 1.5)], effort=5, missed=10)) == 1
    with pytest.raises(hb.GoalError, match="missed: give effort as well"):
        ik.solve((0.3, 1.5), missed=10)
    with pytest.raises(hb.GoalError, match="missed: a positive number"):
        ik.solve((0.3, 1.5), effort=5, missed=0)


@pytest.mark.parametrize(
    ("targets", "options", "fault"),
    [
        ([], {}, "at least one is needed"),
        ([(0.1, 0.2, 0.3)], {}, "2 coordinates, got 3"),
        ([(0.1, 0.2)], {"weights": [0.0]}, "positive numbers"),
        ([(0.1, 0.2)], {"effort": -1}, "effort: a positive number"),
        ([(0.1, 0.2)], {"missed": float("inf")}, "missed: a finite number"),
    ],
)
def test_wrong_targets_are_refused(targets, options, fault):
    arm = hb.Arm([hb.vgt(width=0.2, lengths=(0.2, 0.25), count=2)])
    with pytest.raises(hb.GoalError, match=fault):
        hb.merit(arm, targets, **options)


@given(st.lists(st.floats(0, 100), min_size=2, max_size=20))
def test_the_standard_error_of_equal_weights_is_that_of_statistics(values):
    middle, error = mean(np.array(values), np.ones(len(values)))
    assert middle == pytest.approx(np.mean(values))
    assert error == pytest.approx(np.std(values, ddof=1) / np.sqrt(len(values)), abs=1e-9)
