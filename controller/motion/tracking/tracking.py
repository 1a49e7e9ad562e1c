"""Tracking of a moving goal: a Kalman filter over a stream of set-points, and its prediction."""

import math
from dataclasses import dataclass, fields
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hyperbit.controller.motion.tracking.kalman import kalman_filter, white_noise
from hyperbit.controller.refusals.reasons import Reason
from hyperbit.controller.refusals.refusal import Refusal

Vector = NDArray[np.float64]

GATES = {2: 13.816, 3: 16.266}  # chi-square, 99.9 %, by dimension
FARTHEST = 1e6  # greatest coordinate, as for goals; greater ones overflow when squared
LEAST, MOST = 1e-9, 1e6  # of a value of Tracking; outside, squares lose all precision


@dataclass(frozen=True)
class Tracking:
    """How goals move and how streams behave; lengths in the arm's unit, defaults in metres."""

    acceleration: float = 0.5  # standard deviation of the goal's acceleration between two set-points [m/s^2]
    noise: float = 0.002  # standard deviation of a set-point's coordinate [m]
    # standard deviation of the initial velocity, per coordinate [m/s]; four times this speed is not tracked
    speed: float = 0.5
    timeout: float = 0.25  # silence after which the stream has stopped [s]; predictions look no further ahead
    validity: float = 0.2  # greatest age of a set-point on arrival [s]
    slack: float = 0.02  # how far the sender's clock may be ahead of ours [s]
    agreeing: int = 3  # consecutive outliers that must agree before they start a new track

    def __post_init__(self) -> None:
        """Raises ValueError if a value is out of bounds, or if validity and slack exceed the time-out."""
        for field in fields(self):
            value = getattr(self, field.name)
            if not LEAST <= value <= MOST:
                raise ValueError(f"{field.name}: {value} given, a number from 1e-9 to 1e6 is needed")
        if self.validity + self.slack > self.timeout:  # otherwise the first set-point after a time-out may be too old
            raise ValueError(
                f"validity: {self.validity:g} s and slack {self.slack:g} s exceed timeout {self.timeout:g} s"
            )


def tracking_of(length: float, tolerance: float) -> Tracking:
    """Returns the parameters of goals for an arm of some length, in its own unit.

    The noise of a set-point is about the tolerance of the position. A goal crosses an eighth of the arm's length in one
    second, and reaches that speed in one second.
    """
    speed = min(max(length / 8, LEAST), MOST)
    return Tracking(acceleration=speed, noise=min(max(min(tolerance, length / 100), LEAST), MOST), speed=speed)


class Prediction(NamedTuple):
    """The predicted goal."""

    position: Vector  # in the world, shape (dimension,)
    velocity: Vector  # shape (dimension,) [1/s]
    covariance: Vector  # of the position, shape (dimension, dimension)


class ConstantVelocity:
    """A track: filterpy's Kalman filter over the state [p; v], with white-noise acceleration.

    Attributes:
        time: of the last update [s].
        updates: set-points taken since the start; 0: there is no track.
    """

    def __init__(self, dimension: int, tracking: Tracking) -> None:
        self.time, self.updates = 0.0, 0
        self._dimension, self._tracking = dimension, tracking
        self._kalman = kalman_filter(2 * dimension, dimension)
        self._kalman.H = np.eye(dimension, 2 * dimension)
        self._kalman.R = tracking.noise**2 * np.eye(dimension)
        self._start = np.diag(np.repeat([tracking.noise**2, tracking.speed**2], dimension))

    def start(self, position: Vector, time: float) -> None:
        """Starts at `position` (dimension,) with an unknown velocity of mean zero."""
        self._kalman.x = np.concatenate((position, np.zeros(self._dimension)))
        self._kalman.P = self._start
        self.time, self.updates = time, 1

    def update(self, position: Vector, time: float) -> None:
        transition, noise = self._until(time)
        self._kalman.predict(F=transition, Q=noise)
        self._kalman.update(position)
        self.time, self.updates = time, self.updates + 1

    def predict(self, time: float) -> Prediction:
        transition, noise = self._until(time)
        state, covariance = transition @ self._kalman.x, transition @ self._kalman.P @ transition.T + noise
        d = self._dimension
        return Prediction(state[:d], state[d:], covariance[:d, :d])

    def fits(self, position: Vector, time: float) -> bool:
        """Returns whether `position` (dimension,) at `time` is within the gate around the prediction."""
        prediction = self.predict(time)
        innovation = position - prediction.position
        weighted = np.linalg.solve(prediction.covariance + self._kalman.R, innovation)
        return bool(innovation @ weighted <= GATES[self._dimension])

    def _until(self, time: float) -> tuple[Vector, Vector]:
        """Returns F and Q from the last update to `time`."""
        d, elapsed = self._dimension, time - self.time
        transition = np.eye(2 * d) + elapsed * np.eye(2 * d, k=d)
        noise = white_noise(d, elapsed, self._tracking.acceleration**2)
        return transition, noise


class GoalTracker:
    """Tracks one moving goal. The caller gives all times, UNIX seconds of one clock; stamps are by the sender's clock.

    Attributes:
        outliers: set-points dropped by the gate so far.
        jumps: how often agreeing outliers started a new track.
    """

    def __init__(self, dimension: int, tracking: Tracking | None = None) -> None:
        """Builds the filters, for 2 or 3 dimensions. This is slow: call it before the arm moves."""
        if dimension not in GATES:
            raise ValueError(f"dimension: {dimension} given, goals have 2 or 3 coordinates")
        self._dimension, self._tracking = dimension, tracking or Tracking()
        self._track = ConstantVelocity(dimension, self._tracking)
        self._rival = ConstantVelocity(dimension, self._tracking)  # of the outliers since the last accepted set-point
        self.outliers = self.jumps = 0
        self.forget()

    def forget(self) -> None:
        """Ends the track; the next set-point starts a new one."""
        self._track.updates = self._rival.updates = 0
        self._arrival = self._stamp = -math.inf

    def measure(self, position: ArrayLike, stamp: float | None, arrival: float) -> bool:
        """Takes one set-point (dimension,); returns False if it is an outlier.

        `stamp` is the time of the position by the sender's clock; None: on arrival. `arrival` is the present time.

        Raises:
            Refusal: the set-point is not finite, out of order, stale or from the future. The track does not change.
        """
        point = self._checked(position, stamp, arrival)
        if not self.alive(arrival):  # the stream paused, or our clock was adjusted
            self.forget()
        time = arrival if stamp is None else min(self._ordered(stamp, arrival), arrival)
        return self._associate(point, time, arrival)

    def alive(self, now: float) -> bool:
        """Returns whether the last accepted set-point arrived within the time-out, by our clock."""
        return abs(now - self._arrival) <= self._tracking.timeout

    def predict(self, now: float, lead: float = 0.0) -> Prediction | None:
        """Returns the predicted goal `lead` [s] after `now`, at most the time-out after the last set-point.

        Returns None if the stream is not alive.
        """
        return self._track.predict(self._within(now + lead)) if self.alive(now) else None

    def next_target(self, now: float, lead: float, tip: ArrayLike, tolerance: float) -> Vector | None:
        """Returns the position to search a configuration for; None: the tip may stay within the tolerance.

        The position is half a tolerance ahead of the moving goal. The goal then passes the tip before the tip follows,
        which saves switches. A configuration within the other half of the tolerance is within the tolerance at once.
        A configuration requested `now` is reached after `lead` [s]; otherwise `tip` (dimension,) is the position then.
        """
        goal = self.predict(now, lead)
        if goal is None or np.linalg.norm(goal.position - np.asarray(tip)) <= tolerance:
            return None
        passing = tolerance / 2 / max(float(np.linalg.norm(goal.velocity)), 1e-9)
        return self._track.predict(self._within(now + lead + passing)).position

    def _within(self, time: float) -> float:
        """Returns `time`, at most the time-out after the last update."""
        return min(time, self._track.time + self._tracking.timeout)

    def _checked(self, position: ArrayLike, stamp: float | None, arrival: float) -> Vector:
        point = np.asarray(position, dtype=float)
        if point.shape != (self._dimension,):
            raise Refusal(Reason.WRONG_DIMENSION, where="position", count=str(point.shape), dimension=self._dimension)
        if not (np.abs(point) <= FARTHEST).all():
            needed = f"numbers from {-FARTHEST:g} to {FARTHEST:g}"
            raise Refusal(Reason.NOT_FINITE, where="position", given=str(point.tolist()), needed=needed)
        if not math.isfinite(arrival + (stamp or 0.0)):
            raise Refusal(Reason.NOT_FINITE, where="stamp", given=f"{stamp} at {arrival}", needed="finite times")
        return point

    def _ordered(self, stamp: float, arrival: float) -> float:
        """Returns a stamp that passed the checks, and stores it as the last one."""
        if not stamp <= arrival + self._tracking.slack:
            raise Refusal(Reason.FROM_THE_FUTURE, ahead=f"{stamp - arrival:.3f}", most=self._tracking.slack)
        if stamp < arrival - self._tracking.validity:
            raise Refusal(Reason.STALE, age=f"{arrival - stamp:.3f}", most=self._tracking.validity)
        if stamp <= self._stamp:
            raise Refusal(Reason.OUT_OF_ORDER, early=f"{self._stamp - stamp:.3f}")
        self._stamp = stamp
        return stamp

    def _associate(self, point: Vector, time: float, arrival: float) -> bool:
        """Updates the track with a set-point that fits, or starts one; returns False for an outlier."""
        if not self._track.updates:
            self._track.start(point, time)
        elif self._track.fits(point, time):
            self._track.update(point, time)
        elif not self._rival_won(point, time):
            self.outliers += 1
            return False
        self._rival.updates = 0
        self._arrival = arrival
        return True

    def _rival_won(self, point: Vector, time: float) -> bool:
        """Adds an outlier to the rival track; returns whether the rival has become the track."""
        if self._rival.updates and self._rival.fits(point, time):
            self._rival.update(point, time)
        else:
            self._rival.start(point, time)
        agreed = self._rival.updates >= self._tracking.agreeing
        if agreed:
            self._track, self._rival = self._rival, self._track
            self.jumps += 1
        return agreed
