"""Tracking of a moving goal: a filter of a stream of set-points, and its prediction."""

import math
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hyperbit.controller.motion.tracking.track import GATES, PointModel, Prediction, Track
from hyperbit.controller.refusals.reasons import Reason
from hyperbit.controller.refusals.refusal import Refusal

Vector = NDArray[np.float64]

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


class GoalTracker:
    """Tracks one moving goal. The caller gives all times, in UNIX seconds; stamps are by the sender's clock."""

    def __init__(self, dimension: int, tracking: Tracking | None = None) -> None:
        """Builds the filters, for 2 or 3 dimensions. This is slow: call it before the arm moves."""
        if dimension not in GATES:
            raise ValueError(f"dimension: {dimension} given, goals have 2 or 3 coordinates")
        self._dimension = dimension
        self._tracking = it = tracking or Tracking()
        self.track = Track(dimension, PointModel(2, it.noise, it.acceleration, it.speed, it.agreeing))
        self.forget()

    def forget(self) -> None:
        """Ends the track; the next set-point starts a new one."""
        self.track.forget()
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
        if not self.track.measure(point, time):
            return False
        self._arrival = arrival
        return True

    def alive(self, now: float) -> bool:
        """Returns whether the last accepted set-point arrived within the time-out, by our clock."""
        return abs(now - self._arrival) <= self._tracking.timeout

    def predict(self, now: float, lead: float = 0.0) -> Prediction | None:
        """Returns the predicted goal `lead` [s] after `now`, at most the time-out after the last set-point.

        Returns None if the stream is not alive.
        """
        return self.track.predict(self._within(now + lead)) if self.alive(now) else None

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
        return self.track.predict(self._within(now + lead + passing)).position

    def _within(self, time: float) -> float:
        """Returns `time`, at most the time-out after the last update."""
        return min(time, self.track.time + self._tracking.timeout)

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
