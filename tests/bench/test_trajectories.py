"""The plans of the benchmark's trajectories serve, and no bound is above them."""

import numpy as np

from hyperbit.controller.bench.goal_sets import load_arm
from tests.benchmarks.motion.trajectories import SPACINGS, WAYPOINTS
from tests.benchmarks.proofs.trajectories import ARM, CURVES, FILE, read, write


def test_each_plan_serves_and_costs_at_least_its_bound():
    curves, manipulator = read(), load_arm(ARM).manipulator
    assert [curve.spacing for curve in curves] == [spacing for spacing in SPACINGS for _ in range(CURVES)]
    for curve in curves:
        tips = manipulator.tips(curve.best)[:, :2, 3]
        assert tips.shape == curve.waypoints.shape == (WAYPOINTS, 2)
        assert np.linalg.norm(tips - curve.waypoints, axis=1).max() <= curve.tolerance
        assert 0 < curve.bound <= curve.switches


def test_what_is_written_can_be_read(tmp_path, monkeypatch):
    curves = read()[:2]
    monkeypatch.setattr("tests.benchmarks.proofs.trajectories.FILE", tmp_path / "trajectories.csv")
    write(curves)
    assert (tmp_path / "trajectories.csv").read_text().splitlines() == FILE.read_text().splitlines()[:3]
