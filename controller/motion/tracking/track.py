"""A Kalman filter (filterpy) of a measured point, with a rival hypothesis for measurements that do not fit."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hyperbit.controller.motion.tracking.kalman import kalman_filter, white_noise

Vector = NDArray[np.float64]

GATES = {2: 13.816, 3: 16.266}  # chi-square, 99.9 %, by dimension


class PointModel(NamedTuple):
    """How a point moves and how it is measured; lengths in the arm's unit.

    With `order` 1 the point is a random walk, with `order` 2 it has a velocity with white-noise acceleration.
    """

    order: int
    noise: float  # standard deviation of a measured coordinate
    # standard deviation of a coordinate's change in one second; with order 2, of its acceleration between measurements
    change: float
    speed: float = 0.0  # with order 2, standard deviation of a coordinate's initial velocity [1/s]
    agreeing: int = 1  # consecutive outliers that must agree before they replace the track


class Prediction(NamedTuple):
    """The predicted point."""

    position: Vector  # shape (dimension,)
    velocity: Vector  # shape (dimension,) [1/s]; of a random walk (0,)
    covariance: Vector  # of the position, shape (dimension, dimension)


class Hypothesis:
    """One filter over the state [p] or [p; v]; without updates it does not count."""

    def __init__(self, dimension: int, model: PointModel) -> None:
        self.time, self.updates = -math.inf, 0
        self._dimension, self._model = dimension, model
        self._kalman = kalman_filter(model.order * dimension, dimension)
        self._kalman.H = np.eye(dimension, model.order * dimension)
        self._kalman.R = model.noise**2 * np.eye(dimension)

    def start(self, position: Vector, deviation: float, time: float) -> None:
        """Starts at a position (dimension,) with the standard deviation of a coordinate, and velocities around 0."""
        velocities = self._kalman.dim_x - self._dimension
        self._kalman.x = np.concatenate((position, np.zeros(velocities)))
        self._kalman.P = np.diag([deviation**2] * self._dimension + [self._model.speed**2] * velocities)
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
        """Returns whether a position (dimension,) is within the gate around the prediction."""
        prediction = self.predict(time)
        innovation = position - prediction.position
        weighted = np.linalg.solve(prediction.covariance + self._kalman.R, innovation)
        return bool(innovation @ weighted <= GATES[self._dimension])

    def _until(self, time: float) -> tuple[Vector, Vector]:
        """Returns F and Q from the last update to a time."""
        d, elapsed, change = self._dimension, time - self.time, self._model.change
        if self._model.order == 1:
            return np.eye(d), change**2 * elapsed * np.eye(d)
        return np.eye(2 * d) + elapsed * np.eye(2 * d, k=d), white_noise(d, elapsed, change**2)


class Track:
    """The filter of one point. The caller gives all times, in seconds of one clock, and never an earlier one.

    Attributes:
        outliers: measurements dropped by the gate so far.
        jumps: how often agreeing outliers replaced the track.
    """

    def __init__(self, dimension: int, model: PointModel) -> None:
        """Builds the filters. This is slow: call it before the arm moves."""
        self._model = model
        self._present, self._rival = Hypothesis(dimension, model), Hypothesis(dimension, model)
        self.outliers = self.jumps = 0

    @property
    def time(self) -> float:
        """Time of the last measurement that counts [s]; -inf before the first."""
        return self._present.time

    @property
    def begun(self) -> bool:
        return self._present.updates > 0

    def forget(self) -> None:
        self._present.updates = self._rival.updates = 0

    def start(self, position: Vector, deviation: float, time: float) -> None:
        """Starts from a position (dimension,) with the standard deviation of a coordinate."""
        self._present.start(position, deviation, time)

    def measure(self, position: Vector, time: float) -> bool:
        """Takes a measured position (dimension,), which may begin the track; returns False if it is an outlier."""
        if not self.begun:
            self.start(position, self._model.noise, time)
        elif self._present.fits(position, time):
            self._present.update(position, time)
        elif not self._rival_won(position, time):
            self.outliers += 1
            return False
        self._rival.updates = 0
        return True

    def predict(self, time: float) -> Prediction:
        return self._present.predict(time)

    def _rival_won(self, position: Vector, time: float) -> bool:
        """Adds an outlier to the rival; returns whether the rival has become the track."""
        if self._rival.updates and self._rival.fits(position, time):
            self._rival.update(position, time)
        else:
            self._rival.start(position, self._model.noise, time)
        if self._rival.updates < self._model.agreeing:
            return False
        self._present, self._rival = self._rival, self._present
        self.jumps += 1
        return True
