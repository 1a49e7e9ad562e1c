"""Tracking of a moving goal: a Kalman filter over a stream of setpoints, and where the goal will be."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from controller.motion.codes import OLD_HEADER_TIMESTAMP, Refusal
from controller.motion.goal import refusal
from controller.motion.goal_motion import Tracking
from controller.motion.kalman import kalman_filter, white_noise

Vector = NDArray[np.float64]

GATES = {2: 13.816, 3: 16.266}  # chi-square, 99.9 %, by dimension
FARTHEST = 1e6  # as of goals; what lies beyond would overflow when squared


class Prediction(NamedTuple):
    """Where the goal will be.

    Attributes:
        position: in the world, shape (dimension,).
        velocity: shape (dimension,) [1/s].
        covariance: of the position, shape (dimension, dimension).
    """

    position: Vector
    velocity: Vector
    covariance: Vector


class ConstantVelocity:
    """A track: filterpy's Kalman filter over the state [p; v], with white noise for acceleration.

    Attributes:
        time: of the last update [s].
        updates: setpoints taken since the start, 0: there is no track.
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
        """Begins at rest, of unknown velocity, at `position` (dimension,)."""
        self._kalman.x = np.concatenate((position, np.zeros(self._dimension)))
        self._kalman.P = self._start
        self.time, self.updates = time, 1

    def update(self, position: Vector, time: float) -> None:
        """Takes `position` (dimension,), measured at `time`."""
        transition, noise = self._until(time)
        self._kalman.predict(F=transition, Q=noise)
        self._kalman.update(position)
        self.time, self.updates = time, self.updates + 1

    def predict(self, time: float) -> Prediction:
        """Returns where the goal is at `time`."""
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
    """Follows one moving goal. All times come from the caller, UNIX seconds of one clock, save the senders' stamps.

    Attributes:
        outliers: setpoints dropped by the gate so far.
        jumps: how often the track was started anew where outliers agreed.
    """

    def __init__(self, dimension: int, tracking: Tracking | None = None) -> None:
        """Builds the filters; slow, to be done before anything moves.

        Raises:
            ValueError: the dimension is neither 2 nor 3.
        """
        if dimension not in GATES:
            raise ValueError(f"dimension: {dimension} given, goals have 2 or 3 coordinates")
        self._dimension, self._tracking = dimension, tracking or Tracking()
        self._track = ConstantVelocity(dimension, self._tracking)
        self._rival = ConstantVelocity(dimension, self._tracking)  # of the outliers since the last setpoint that fitted
        self.outliers = self.jumps = 0
        self.forget()

    def forget(self) -> None:
        """Ends the track; the next setpoint starts one."""
        self._track.updates = self._rival.updates = 0
        self._arrival = self._stamp = -math.inf

    def measure(self, position: ArrayLike, stamp: float | None, arrival: float) -> bool:
        """Takes one setpoint, and returns whether it belongs to the track; else it is an outlier.

        Args:
            position: of the goal, shape (dimension,).
            stamp: when the goal was there by the sender's clock, None: on arrival.
            arrival: now.

        Raises:
            Refusal: it is not finite, out of order, stale or from the future; the track is as before.
        """
        point = self._checked(position, stamp, arrival)
        if not self.alive(arrival):  # the stream paused, or our clock was set
            self.forget()
        time = arrival if stamp is None else min(self._ordered(stamp, arrival), arrival)
        return self._associate(point, time, arrival)

    def alive(self, now: float) -> bool:
        """Returns whether a setpoint that fits the track arrived within the time-out, by our clock alone."""
        return abs(now - self._arrival) <= self._tracking.timeout

    def predict(self, now: float, lead: float = 0.0) -> Prediction | None:
        """Returns where the goal will be, None when the stream is not alive.

        Args:
            now: time by our clock.
            lead: how far ahead to look, cut where it exceeds the time-out after the last setpoint [s].
        """
        return self._track.predict(self._within(now + lead)) if self.alive(now) else None

    def wants(self, now: float, lead: float, tip: ArrayLike, tolerance: float) -> Vector | None:
        """Returns the position to solve a new configuration for; None: stay.

        It is half the tolerance ahead of a moving goal: the tip lets the goal pass before it follows, and switches
        less. A configuration within the other half of the tolerance is within all of it from the start.

        Args:
            now: time by our clock.
            lead: time until a configuration that is asked for now is reached [s].
            tip: where the tip will be by then if nothing is asked for, shape (dimension,).
            tolerance: the tip stays while the goal will be no farther from it.
        """
        goal = self.predict(now, lead)
        if goal is None or np.linalg.norm(goal.position - np.asarray(tip)) <= tolerance:
            return None
        passing = tolerance / 2 / max(float(np.linalg.norm(goal.velocity)), 1e-9)
        return self._track.predict(self._within(now + lead + passing)).position

    def _within(self, time: float) -> float:
        """Returns `time`, or the last that the track can tell of."""
        return min(time, self._track.time + self._tracking.timeout)

    def _checked(self, position: ArrayLike, stamp: float | None, arrival: float) -> Vector:
        """Returns a position that the filter can take."""
        point = np.asarray(position, dtype=float)
        if point.shape != (self._dimension,):
            raise refusal(f"position: shape {point.shape} given, this arm's goals have shape ({self._dimension},)")
        if not (np.abs(point) <= FARTHEST).all():
            raise refusal(f"position: {point.tolist()} given, numbers from {-FARTHEST:g} to {FARTHEST:g} are needed")
        if not math.isfinite(arrival + (stamp or 0.0)):
            raise refusal(f"stamp: {stamp} given at {arrival}, finite times are needed")
        return point

    def _ordered(self, stamp: float, arrival: float) -> float:
        """Returns a stamp that has passed the checks, and keeps it."""
        if not stamp <= arrival + self._tracking.slack:
            ahead = f"{stamp - arrival:.3f} s in the future, at most {self._tracking.slack:g} s are taken"
            raise refusal(f"stamp: {ahead}; stamps are UNIX seconds")
        if stamp < arrival - self._tracking.validity:
            age = f"{arrival - stamp:.3f} s old on arrival, at most {self._tracking.validity:g} s are taken"
            raise Refusal(OLD_HEADER_TIMESTAMP, f"stamp: {age}")
        if stamp <= self._stamp:
            raise Refusal(OLD_HEADER_TIMESTAMP, f"stamp: {self._stamp - stamp:.3f} s before the last one taken")
        self._stamp = stamp
        return stamp

    def _associate(self, point: Vector, time: float, arrival: float) -> bool:
        """Gives a setpoint to the track that it fits; without any it starts one."""
        if not self._track.updates:
            self._track.start(point, time)
        elif self._track.fits(point, time):
            self._track.update(point, time)
        elif not self._rivals(point, time):
            self.outliers += 1
            return False
        self._rival.updates = 0
        self._arrival = arrival
        return True

    def _rivals(self, point: Vector, time: float) -> bool:
        """Gives an outlier to the rival track, and returns whether that has now become the goal's."""
        if self._rival.updates and self._rival.fits(point, time):
            self._rival.update(point, time)
        else:
            self._rival.start(point, time)
        agreed = self._rival.updates >= self._tracking.agreeing
        if agreed:
            self._track, self._rival = self._rival, self._track
            self.jumps += 1
        return agreed
