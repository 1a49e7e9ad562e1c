"""Tracking of a moving goal: a Kalman filter over a stream of set-points, and its prediction."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hyperbit.controller.motion.tracking.goal_motion import Tracking
from hyperbit.controller.motion.tracking.kalman import kalman_filter, white_noise
from hyperbit.controller.refusals.reasons import Reason
from hyperbit.controller.refusals.refusal import Refusal

Vector = NDArray[np.float64]

GATES = {2: 13.816, 3: 16.266}  # chi-square, 99.9 %, by dimension
FARTHEST = 1e6  # greatest coordinate, as for goals; greater ones overflow when squared


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
        """Builds the matrices, and imports filterpy."""
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
        """Updates the track with `position` (dimension,), measured at `time`."""
        transition, noise = self._until(time)
        self._kalman.predict(F=transition, Q=noise)
        self._kalman.update(position)
        self.time, self.updates = time, self.updates + 1

    def predict(self, time: float) -> Prediction:
        """Returns the predicted goal at `time`."""
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
        """Builds the filters. This is slow: call it before the arm moves.

        Raises:
            ValueError: the dimension is neither 2 nor 3.
        """
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
        """Takes one set-point; returns False if it is an outlier.

        Args:
            position: of the goal, shape (dimension,).
            stamp: time of the position by the sender's clock; None: on arrival.
            arrival: present time.

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
        """Returns the predicted goal; None if the stream is not alive.

        Args:
            now: present time by our clock.
            lead: how far ahead to predict [s]; at most to the time-out after the last set-point.
        """
        return self._track.predict(self._within(now + lead)) if self.alive(now) else None

    def next_target(self, now: float, lead: float, tip: ArrayLike, tolerance: float) -> Vector | None:
        """Returns the position to search a configuration for; None: the tip may stay.

        The position is half a tolerance ahead of the moving goal. The goal then passes the tip before the tip follows,
        which saves switches. A configuration within the other half of the tolerance is within the tolerance at once.

        Args:
            now: present time by our clock.
            lead: time until a configuration requested now is reached [s].
            tip: position of the tip then if nothing is requested, shape (dimension,).
            tolerance: greatest distance from the predicted goal at which the tip stays.
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
        """Returns the position if the filter can take it."""
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
