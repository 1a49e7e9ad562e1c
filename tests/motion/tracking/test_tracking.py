"""Tracking of a moving goal: accuracy of the filter, dropped outliers, end of the stream, switches of the arm."""

import math
import subprocess
import sys
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hyperbit.controller.motion.tracking.tracking import GoalTracker, Tracking, tracking_of
from hyperbit.controller.refusals.codes import INVALID_GOAL, OLD_HEADER_TIMESTAMP
from hyperbit.controller.refusals.refusal import Refusal
from hyperbit.controller.search.solver import Solver

NOW = 1_800_000_000.0
DELAY = 0.06  # from a decision to the tip's arrival [s]
TIMEOUT = Tracking().timeout


@dataclass(frozen=True, eq=False)
class Stream:
    """Set-points (n, 2) of a goal on a circle, their stamps and arrivals (n,), and which are outliers."""

    positions: np.ndarray
    stamps: np.ndarray
    arrivals: np.ndarray
    outliers: np.ndarray


def circle(times: Any) -> np.ndarray:
    """True goal (n, 2): 0.1 m/s on a circle of 0.2 m."""
    angle = (np.atleast_1d(times) - NOW) * 0.1 / 0.2
    return np.array([0.5, 2.8]) + 0.2 * np.column_stack((np.cos(angle), np.sin(angle)))


def stream(rate: float, share: float = 0.01, seconds: float = 20.0) -> Stream:
    """Irregular set-points with 2 mm of jitter, delays of some 1 ms, and a share of outliers of 0.5 m."""
    rng = np.random.default_rng(0)
    n = int(rate * seconds)
    stamps = NOW + np.cumsum(rng.uniform(0.3, 1.7, n)) / rate
    arrivals = np.maximum.accumulate(stamps + rng.exponential(0.001, n))
    outliers, angle = rng.random(n) < share, rng.uniform(0, 2 * math.pi, n)
    outliers[0] = False
    away = 0.5 * outliers[:, None] * np.column_stack((np.cos(angle), np.sin(angle)))
    return Stream(circle(stamps) + rng.normal(0, 0.002, (n, 2)) + away, stamps, arrivals, outliers)


def rms(errors: np.ndarray) -> float:
    return float(np.sqrt((errors**2).sum(axis=-1).mean()))


def still(tracker: GoalTracker, at: float, count: int = 20, position: Any = (0.5, 2.9)) -> float:
    """Streams one position at 100 Hz; returns the last arrival."""
    for k in range(count):
        assert tracker.measure(position, at + 0.01 * k, at + 0.01 * k)
    return at + 0.01 * (count - 1)


@pytest.mark.parametrize("velocity", [(0.3, -0.1), (0.3, -0.1, 0.2)])
def test_converges_on_a_constant_velocity(velocity):
    tracker = GoalTracker(len(velocity))
    times = NOW + np.cumsum(np.random.default_rng(0).uniform(0.002, 0.02, 200))
    goal = 1 + (times - NOW)[:, None] * velocity
    assert all(tracker.measure(p, None, t) for p, t in zip(goal, times, strict=True))
    prediction = tracker.predict(times[-1], 0.1)
    assert prediction.position == pytest.approx(goal[-1] + 0.1 * np.array(velocity), abs=1e-3)
    assert prediction.velocity == pytest.approx(velocity, abs=1e-2)
    assert prediction.covariance.shape == (len(velocity), len(velocity))
    assert np.all(np.linalg.eigvalsh(prediction.covariance) > np.linalg.eigvalsh(tracker.predict(times[-1]).covariance))


def test_the_covariance_tells_the_error_of_a_goal_as_modelled():
    rng, tracker, squared = np.random.default_rng(0), GoalTracker(2), []
    position, velocity = np.array([1.0, 2.0]), np.array([0.1, 0.0])
    for k in range(3000):
        acceleration = rng.normal(0, Tracking().acceleration, 2)
        position = position + 0.01 * velocity + 0.5 * 0.01**2 * acceleration
        velocity = velocity + 0.01 * acceleration
        tracker.measure(position + rng.normal(0, Tracking().noise, 2), None, NOW + 0.01 * k)
        _, _, covariance = prediction = tracker.predict(NOW + 0.01 * k)
        error = position - prediction.position
        squared.append(error @ np.linalg.solve(covariance, error))
    assert np.mean(squared) == pytest.approx(2, rel=0.15)  # the mean of chi-square in 2 dimensions


@pytest.mark.parametrize("stamped", [True, False])
@pytest.mark.parametrize("rate", [200, 50])
def test_lead_brings_the_prediction_nearer_than_the_raw_stream(rate, stamped):
    s, tracker = stream(rate), GoalTracker(2)
    led, level = [], []
    for position, stamp, now in zip(s.positions, s.stamps, s.arrivals, strict=True):
        tracker.measure(position, stamp if stamped else None, now)
        led.append(tracker.predict(now, DELAY).position)
        level.append(tracker.predict(now).position)
    true = circle(s.arrivals + DELAY)
    inliers = rms((s.positions - true)[~s.outliers])
    assert rms(led - true) < 0.5 * inliers < 0.25 * rms(s.positions - true)
    assert rms(level - true) > 0.9 * inliers  # filtering alone improves little
    assert s.outliers.sum() <= tracker.track.outliers <= s.outliers.sum() + 0.01 * len(s.stamps)
    assert tracker.track.jumps == 0


def test_outliers_leave_the_track_where_it_is():
    tracker = GoalTracker(2)
    now = still(tracker, NOW)
    before = tracker.predict(now).position
    for k, away in enumerate([(1, 0), (0, 1), (-1, 0), (0, -1)] * 5):
        assert not tracker.measure(np.add((0.5, 2.9), away), None, now + 0.01 * (k + 1))
    assert tracker.predict(now).position == pytest.approx(before, abs=1e-12)
    assert (tracker.track.outliers, tracker.track.jumps) == (20, 0)


@pytest.mark.parametrize(("dimension", "quantile"), [(2, 13.816), (3, 16.266)])
def test_the_gate_lets_999_of_1000_pass(dimension, quantile):
    for scale, passes in [(0.99, True), (1.01, False)]:
        tracker = GoalTracker(dimension)
        now = still(tracker, NOW, position=np.ones(dimension)) + 0.01
        prediction = tracker.predict(now)
        spread = math.sqrt(quantile * (prediction.covariance[0, 0] + Tracking().noise ** 2))
        assert tracker.measure(prediction.position + scale * spread * np.eye(dimension)[0], None, now) == passes


def test_a_stamp_from_the_near_future_counts_as_of_its_arrival():
    ahead, level = GoalTracker(2), GoalTracker(2)
    for k in range(100):
        now = NOW + 0.01 * k
        assert ahead.measure((0.01 * k, 0), now + 0.015, now)
        assert level.measure((0.01 * k, 0), None, now)
    assert ahead.predict(now, DELAY).position.tolist() == level.predict(now, DELAY).position.tolist()


@pytest.mark.parametrize("rate", [200, 50])
def test_streams_with_and_without_stamps_may_mix(rate):
    s, tracker, predictions = stream(rate, share=0.0), GoalTracker(2), []
    for k, (position, stamp, now) in enumerate(zip(s.positions, s.stamps, s.arrivals, strict=True)):
        tracker.measure(position, stamp if k % 2 else None, now)
        predictions.append(tracker.predict(now, DELAY).position)
    assert rms(predictions - circle(s.arrivals + DELAY)) < 0.003


def test_a_jump_is_followed_from_the_third_setpoint_on():
    tracker = GoalTracker(2)
    now = still(tracker, NOW)
    taken = [tracker.measure((1.0, 2.0), None, now + 0.01 * k) for k in (1, 2, 3, 4)]
    assert taken == [False, False, True, True]
    assert tracker.predict(now + 0.04).position == pytest.approx((1.0, 2.0), abs=1e-3)
    assert (tracker.track.outliers, tracker.track.jumps) == (2, 1)


def refused(tracker: GoalTracker, stamp: float | None, arrival: float, position: Any = (0.5, 2.9)) -> tuple[int, str]:
    with pytest.raises(Refusal) as caught:
        tracker.measure(position, stamp, arrival)
    return caught.value.code, str(caught.value)


def test_stamps_out_of_order_stale_or_from_the_future_are_refused_with_by_how_much():
    tracker = GoalTracker(2)
    tracker.measure((0.5, 2.9), NOW, NOW)
    assert refused(tracker, NOW - 0.05, NOW) == (OLD_HEADER_TIMESTAMP, "stamp: 0.050 s before the last accepted one")
    assert refused(tracker, NOW, NOW + 0.01) == (OLD_HEADER_TIMESTAMP, "stamp: 0.000 s before the last accepted one")
    assert refused(tracker, NOW - 3, NOW)[1] == "stamp: 3.000 s old on arrival, at most 0.2 s are accepted"
    code, sentence = refused(tracker, NOW + 0.1, NOW)
    assert (code, sentence[:60]) == (INVALID_GOAL, "stamp: 0.100 s in the future, at most 0.02 s are accepted; s")
    assert tracker.measure((0.5, 2.9), NOW + 0.01, NOW + 0.15)
    assert tracker.track.outliers == 0


@pytest.mark.parametrize("offset", [-3600, -0.3, 0.05, 3600])
def test_a_sender_with_a_wrong_clock_moves_nothing(offset):
    tracker = GoalTracker(2)
    for k in range(100):
        refused(tracker, NOW + 0.01 * k + offset, NOW + 0.01 * k)
    assert not tracker.alive(NOW + 1)


@pytest.mark.parametrize("offset", [-0.15, -0.01, 0.0, 0.015])
def test_the_time_out_counts_from_the_arrival_whatever_the_stamp(offset):
    tracker = GoalTracker(2)
    for k in range(20):
        now = NOW + 0.01 * k
        tracker.measure((0.5, 2.9), now + offset, now)
    assert tracker.alive(now + TIMEOUT - 1e-3)
    assert not tracker.alive(now + TIMEOUT + 1e-3)


def test_a_burst_of_old_setpoints_does_not_wake_the_stream():
    tracker = GoalTracker(2)
    still(tracker, NOW)
    for k in range(20):
        refused(tracker, NOW + 0.2 + 0.01 * k, NOW + 4)
    assert tracker.predict(NOW + 4) is None


def test_a_quiet_stream_holds_and_a_new_one_starts_anew():
    tracker = GoalTracker(2)
    assert tracker.predict(NOW) is None
    now = still(tracker, NOW)
    assert tracker.next_target(now + TIMEOUT - 1e-3, DELAY, (0, 0), 0.01) is not None
    assert tracker.predict(now + TIMEOUT + 1e-3) is None
    assert tracker.next_target(now + TIMEOUT + 1e-3, DELAY, (0, 0), 0.01) is None
    assert tracker.measure((1.0, 2.0), None, now + 1)
    assert tracker.predict(now + 1).position.tolist() == [1, 2]
    tracker.forget()
    assert not tracker.alive(now + 1)


@pytest.mark.parametrize("step", [-3600, -1, 3600])
def test_our_own_clock_may_be_set(step):
    tracker = GoalTracker(2)
    now = still(tracker, NOW) + step
    assert not tracker.alive(now)
    still(tracker, now, position=(1.0, 2.0))
    assert tracker.predict(now + 0.2).position == pytest.approx((1.0, 2.0), abs=1e-6)


def test_no_prediction_looks_further_than_the_time_out():
    tracker = GoalTracker(2)
    for k in range(100):
        now = NOW + 0.01 * k
        tracker.measure((0.001 * k, 0), None, now)
    farthest = tracker.predict(now, TIMEOUT).position
    assert farthest == pytest.approx((0.099 + 0.1 * TIMEOUT, 0), abs=1e-3)
    assert tracker.predict(now, 1e9).position.tolist() == farthest.tolist()
    assert tracker.predict(now + 0.2, 0.2).position.tolist() == farthest.tolist()
    assert np.all(np.diag(tracker.predict(now, TIMEOUT).covariance) > (Tracking().acceleration * TIMEOUT**2 / 2) ** 2)


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, 1e300])
def test_what_is_not_finite_never_reaches_the_filter(value):
    tracker = GoalTracker(2)
    now = still(tracker, NOW)
    before = tracker.predict(now, DELAY).position.tolist()
    assert refused(tracker, None, now, (value, 2.9))[1].startswith("position: [")
    refused(tracker, value, now)
    if not math.isfinite(value):
        refused(tracker, None, value)
    assert tracker.predict(now, DELAY).position.tolist() == before


@pytest.mark.parametrize("position", [(1,), (1, 2, 3), 1, [[1, 2]]])
def test_a_wrong_dimension_is_refused(position):
    assert "this arm's positions have 2" in refused(GoalTracker(2), None, NOW, position)[1]


def test_wrong_parameters_are_refused_by_name():
    for name in ("acceleration", "noise", "speed", "timeout", "validity", "slack", "agreeing"):
        for value in (0, -1, math.nan, math.inf):
            with pytest.raises(ValueError, match=f"^{name}: "):
                replace(Tracking(), **{name: value})
    with pytest.raises(ValueError, match=r"validity: 0.5 s and slack 0.02 s exceed timeout 0.25 s"):
        Tracking(validity=0.5)
    with pytest.raises(ValueError, match="dimension: 4 given"):
        GoalTracker(4)


def test_jitter_within_the_tolerance_wants_nothing():
    tracker, rng = GoalTracker(2), np.random.default_rng(0)
    for k in range(2000):
        now = NOW + 0.005 * k
        tracker.measure(rng.normal((0.5, 2.9), 0.002), None, now)
        assert k < 20 or tracker.next_target(now, DELAY, (0.504, 2.9), 0.01) is None
    assert tracker.next_target(now, DELAY, (0.52, 2.9), 0.01) == pytest.approx((0.5, 2.9), abs=0.005)


def test_what_is_wanted_is_half_the_tolerance_ahead_of_the_goal():
    tracker = GoalTracker(2)
    for k in range(100):
        now = NOW + 0.01 * k
        tracker.measure((0.001 * k, 0), None, now)
    goal = tracker.predict(now, DELAY).position
    assert tracker.next_target(now, DELAY, goal - (0.009, 0), 0.01) is None
    assert tracker.next_target(now, DELAY, goal - (0.011, 0), 0.01) == pytest.approx(np.add(goal, (0.005, 0)), abs=1e-4)


coordinates = st.floats(-1e6, 1e6) | st.floats(-1, 1)
steps = st.sampled_from([0.0, 1e-7, 0.005, 0.02, 0.2, 1.0, -0.1, -10.0]) | st.floats(-1, 1)
lags = st.none() | st.floats(-0.01, 0.3)


@pytest.mark.parametrize("dimension", [2, 3])
@given(data=st.data())
def test_finite_setpoints_never_give_nan(dimension, data):
    tracker, now = GoalTracker(dimension), NOW
    points = st.lists(coordinates, min_size=dimension, max_size=dimension)
    for position, step, lag in data.draw(st.lists(st.tuples(points, steps, lags), max_size=30)):
        now += step
        try:
            tracker.measure(position, None if lag is None else now - lag, now)
        except Refusal as error:
            assert str(error).startswith("stamp: ")  # noqa: PT017
        prediction = tracker.predict(now, DELAY)
        assert prediction is None or all(np.isfinite(part).all() for part in prediction)
        wanted = tracker.next_target(now, DELAY, np.zeros(dimension), 0.01)
        assert wanted is None or np.isfinite(wanted).all()


def test_importing_it_does_not_import_filterpy():
    code = "import sys, hyperbit.controller.motion.tracking.tracking\n"
    code += "assert not {'filterpy', 'scipy'} & set(sys.modules)"
    subprocess.run([sys.executable, "-c", code], check=True, timeout=60)


def follow(solver: Solver, s: Stream, tracker: GoalTracker | None, within: float) -> tuple[int, float]:
    """Switches of an arm that follows the tracker, or without one the raw stream, and RMS error of its tip."""
    tolerance, manipulator = 0.01, solver.manipulator
    configuration = solver.solve(solver.target(circle(NOW)[0], tolerance), np.zeros(16, dtype=np.int64)).configuration
    reached = coming = manipulator.tip(configuration)[:2, 3]
    due, switches, errors = NOW, 0, []
    for position, stamp, now in zip(s.positions, s.stamps, s.arrivals, strict=True):
        if now >= due:
            reached = coming
        errors.append(reached - circle(now)[0])
        if tracker is not None:
            tracker.measure(position, stamp, now)
            goal = tracker.next_target(now, DELAY, coming, tolerance)
        else:
            goal = None if np.linalg.norm(position - coming) <= tolerance else position
        if goal is None or now < due:
            continue
        solution = solver.solve(solver.target(goal, within), configuration)
        if solution.switches:
            configuration, coming, due = solution.configuration, solution.tip[:2, 3], now + DELAY
            switches += solution.switches
    return switches, rms(np.array(errors))


@pytest.mark.parametrize(  # half of all: each two values once
    ("rate", "share", "within"), [(200, 0.0, 0.01), (200, 0.01, 0.005), (50, 0.0, 0.005), (50, 0.01, 0.01)]
)
def test_the_arm_follows_nearer_and_with_fewer_switches_than_the_raw_stream(solver, rate, share, within):
    s = stream(rate, share)
    raw_switches, raw_error = follow(solver, s, None, within)
    switches, error = follow(solver, s, GoalTracker(2), within)
    assert switches < raw_switches
    assert error < 0.7 * raw_error


@pytest.mark.parametrize("unit", [1.0, 1000.0, 0.001])
def test_a_goal_is_followed_in_whatever_unit_the_arm_has(unit: float) -> None:
    tracker = GoalTracker(2, tracking_of(4.0 * unit, 0.002 * unit))
    for k in range(50):
        assert tracker.measure((unit * (0.5 - 0.002 * k), unit), None, 0.02 * k)
    goal = tracker.predict(0.98, 0.1)
    assert goal is not None
    assert goal.position[0] / unit == pytest.approx(0.5 - 0.002 * 49 - 0.01, abs=2e-3)
    assert goal.velocity[0] / unit == pytest.approx(-0.1, abs=0.02)
