"""How far the tip really is from where the actuators' states put it: filterpy's Kalman filter over measured tips.

The bias, measured minus computed, is kept in the world's frame, as a base that has settled or an arm that sags make it.
It changes slowly, as a random walk. Errors of single configurations are for calibration to find.
"""

import math
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from msgspec import Meta, Struct
from numpy.typing import NDArray

from controller.motion.codes import OLD_HEADER_TIMESTAMP, Refusal
from controller.motion.goal import Coordinate, Time, refusal
from controller.motion.kalman import kalman_filter
from controller.motion.setpoint import parse
from controller.motion.tracking import GATES

Vector = NDArray[np.float64]

DRIFT = 0.1  # of the noise, where nothing is said
FARTHEST = 2.0  # clamps that a tip may be from the computed one
AGREEING = 20  # outliers in a row that agree on another bias make it the tip's


class MeasuredTipMessage(Struct, forbid_unknown_fields=True, frozen=True):
    """The payload of a measured tip; `stamp` is UNIX seconds at which it was there. An orientation corrects nothing."""

    position: Annotated[list[Coordinate], Meta(min_length=2, max_length=3)]
    stamp: Time
    orientation: Coordinate | Annotated[list[Coordinate], Meta(min_length=4, max_length=4)] | None = None


def decode(payload: bytes, dimension: int) -> tuple[Vector, float]:
    """Returns position (dimension,) and stamp [UNIX s] of the measured tip in a payload.

    Raises:
        Refusal: what is wrong, by field; nothing else, whatever the bytes.
    """
    message = parse(payload, MeasuredTipMessage, "measured tip")
    if len(message.position) != dimension:
        raise refusal(f"position: {len(message.position)} coordinates, this arm's tip has {dimension}")
    if isinstance(message.orientation, list) == (dimension == 2) and message.orientation is not None:
        wanted = "an angle" if dimension == 2 else "a quaternion x, y, z, w"
        raise refusal(f"orientation: {wanted} is needed for this arm")
    return np.array(message.position), message.stamp


@dataclass(frozen=True)
class Tracker:
    """What is known of tracker and tip.

    Attributes:
        noise: standard deviation of a measured coordinate.
        clamp: greatest length of a bias that goals are corrected by.
        drift: standard deviation by which the bias changes in a second.
        hold: how long it is believed after the last sample [s].
    """

    noise: float
    clamp: float
    drift: float
    hold: float


class Walk:
    """A bias that walks at random: a Kalman filter without any motion but that."""

    def __init__(self, dimension: int, tracker: Tracker) -> None:
        """Builds the matrices, and imports filterpy."""
        self._dimension, self._tracker = dimension, tracker
        self._kalman = kalman_filter(dimension, dimension)
        self._kalman.F = self._kalman.H = np.eye(dimension)
        self._kalman.R = tracker.noise**2 * np.eye(dimension)
        self.time, self.updates = -math.inf, 0

    @property
    def bias(self) -> Vector:
        """The estimate, shape (dimension,)."""
        return np.asarray(self._kalman.x).copy()

    @property
    def deviation(self) -> float:
        """Standard deviation of a coordinate of it."""
        return float(np.sqrt(self._kalman.P[0, 0]))

    def start(self, bias: Vector, deviation: float, time: float) -> None:
        """Begins with a bias (dimension,) as sure as this."""
        self._kalman.x, self._kalman.P = bias.copy(), deviation**2 * np.eye(self._dimension)
        self.time, self.updates = time, 1

    def fits(self, difference: Vector, time: float) -> bool:
        """Returns whether a difference (dimension,) is within the gate around the estimate."""
        variance = self._kalman.P[0, 0] + self._walked(time) + self._tracker.noise**2  # of every coordinate alike
        missed = difference - self._kalman.x
        return bool(missed @ missed <= GATES[self._dimension] * variance)

    def update(self, difference: Vector, time: float) -> None:
        """Takes a difference (dimension,) measured at a time."""
        self._kalman.predict(Q=self._walked(time) * np.eye(self._dimension))
        self._kalman.update(difference)
        self.time, self.updates = time, self.updates + 1

    def _walked(self, time: float) -> float:
        return self._tracker.drift**2 * max(time - self.time, 0.0)


class TipBias:
    """The bias of one arm's tip. All times come from the caller, seconds of one clock.

    Attributes:
        outliers: differences dropped by the gate so far.
        jumps: how often outliers that agreed became the bias.
    """

    def __init__(self, dimension: int, tracker: Tracker) -> None:
        """Builds the filters; slow, to be done before anything moves."""
        self._tracker, self._none = tracker, np.zeros(dimension)
        self._walk, self._rival = Walk(dimension, tracker), Walk(dimension, tracker)
        self.outliers = self.jumps = 0

    def measure(self, difference: Vector, time: float) -> bool:
        """Takes measured minus computed (dimension,), and returns whether it fits; else it is an outlier.

        Raises:
            Refusal: it is older than the last, or farther than any bias that would be corrected.
        """
        if time <= self._walk.time:
            raise Refusal(OLD_HEADER_TIMESTAMP, f"stamp: {self._walk.time - time:.3f} s before the last one taken")
        far, most = float(np.linalg.norm(difference)), FARTHEST * self._tracker.clamp
        if far > most:
            raise refusal(f"position: {far:.4g} from the computed tip, at most {most:.4g} is taken, twice the clamp")
        if time - self._walk.time > self._tracker.hold:
            self._walk.start(self._none, self._tracker.clamp, time)
        if self._walk.fits(difference, time):
            self._walk.update(difference, time)
        elif not self._agreed(difference, time):
            self.outliers += 1
            return False
        self._rival.updates = 0
        return True

    def at(self, time: float) -> Vector:
        """Returns what goals are corrected by (dimension,), no longer than the clamp; none long after all samples."""
        if not time - self._walk.time <= self._tracker.hold:
            return self._none
        bias = self._walk.bias
        return np.asarray(bias * min(1.0, self._tracker.clamp / max(float(np.linalg.norm(bias)), 1e-300)))

    @property
    def estimate(self) -> tuple[Vector, float] | None:
        """The estimate before it is clamped, shape (dimension,), and its deviation; None before the first sample."""
        return (self._walk.bias, self._walk.deviation) if self._walk.updates else None

    def _agreed(self, difference: Vector, time: float) -> bool:
        """Gives an outlier to the rival, and returns whether that has now become the tip's."""
        if self._rival.updates and self._rival.fits(difference, time):
            self._rival.update(difference, time)
        else:
            self._rival.start(difference, self._tracker.noise, time)
        if self._rival.updates < AGREEING:
            return False
        self._walk, self._rival = self._rival, self._walk
        self.jumps += 1
        return True
