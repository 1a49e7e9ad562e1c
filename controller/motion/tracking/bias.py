"""Tip bias: a Kalman filter (filterpy) over the difference between measured and computed tips.

The bias is measured minus computed position, in the world's frame. Causes are a base that has settled or an arm that
sags. The model is a random walk. Errors that depend on the configuration are corrected by calibration.
"""

import math
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from msgspec import Meta, Struct
from numpy.typing import NDArray

from hyperbit.controller.armfile.fields import Angle, Coordinate
from hyperbit.controller.motion.decoding.goal import Time
from hyperbit.controller.motion.decoding.payloads import parse
from hyperbit.controller.motion.tracking.kalman import kalman_filter
from hyperbit.controller.motion.tracking.tracking import GATES
from hyperbit.controller.refusals.reasons import Reason
from hyperbit.controller.refusals.refusal import Refusal

Vector = NDArray[np.float64]

DRIFT = 0.1  # default drift, as a share of the noise
FARTHEST = 2.0  # greatest distance of a measured tip from the computed one, in clamps
AGREEING = 20  # consecutive outliers that must agree before they replace the bias


class MeasuredTipMessage(Struct, forbid_unknown_fields=True, frozen=True):
    """The payload of a measured tip; `stamp` is the time of the measurement [UNIX s]. `orientation` is not used."""

    position: Annotated[list[Coordinate], Meta(min_length=2, max_length=3)]
    stamp: Time
    orientation: Angle | Annotated[list[Coordinate], Meta(min_length=4, max_length=4)] | None = None


def decode(payload: bytes, dimension: int) -> tuple[Vector, float]:
    """Returns position (dimension,) and stamp [UNIX s] of the measured tip in a payload.

    Raises:
        Refusal: the payload is invalid; the message names the field. No other exception is raised.
    """
    message = parse(payload, MeasuredTipMessage, "measured tip")
    if len(message.position) != dimension:
        raise Refusal(Reason.WRONG_DIMENSION, where="position", count=len(message.position), dimension=dimension)
    if isinstance(message.orientation, list) == (dimension == 2) and message.orientation is not None:
        wanted = "an angle" if dimension == 2 else "a quaternion x, y, z, w"
        raise Refusal(Reason.OTHER_ORIENTATION, wanted=wanted)
    return np.array(message.position), message.stamp


@dataclass(frozen=True)
class Tracker:
    """Parameters of the bias filter, from the arm's file."""

    noise: float  # standard deviation of a measured coordinate
    clamp: float  # greatest length of a bias by which goals are corrected
    drift: float  # standard deviation of the bias's change in one second
    hold: float  # time for which the bias is used after the last sample [s]


class RandomWalk:
    """A Kalman filter of a bias that is a random walk."""

    def __init__(self, dimension: int, tracker: Tracker) -> None:
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
        """Standard deviation of one coordinate of the estimate."""
        return float(np.sqrt(self._kalman.P[0, 0]))

    def start(self, bias: Vector, deviation: float, time: float) -> None:
        """Restarts the filter from a bias (dimension,) with a standard deviation."""
        self._kalman.x, self._kalman.P = bias.copy(), deviation**2 * np.eye(self._dimension)
        self.time, self.updates = time, 1

    def fits(self, difference: Vector, time: float) -> bool:
        """Returns whether a difference (dimension,) is within the gate around the estimate."""
        variance = self._kalman.P[0, 0] + self._added_variance(time) + self._tracker.noise**2  # of each coordinate
        missed = difference - self._kalman.x
        return bool(missed @ missed <= GATES[self._dimension] * variance)

    def update(self, difference: Vector, time: float) -> None:
        """Updates the estimate with a difference (dimension,) measured at a time."""
        self._kalman.predict(Q=self._added_variance(time) * np.eye(self._dimension))
        self._kalman.update(difference)
        self.time, self.updates = time, self.updates + 1

    def _added_variance(self, time: float) -> float:
        return self._tracker.drift**2 * max(time - self.time, 0.0)


class TipBias:
    """The tip bias of one arm. The caller gives all times, in seconds of one clock.

    Attributes:
        outliers: differences dropped by the gate so far.
        jumps: how often agreeing outliers replaced the bias.
    """

    def __init__(self, dimension: int, tracker: Tracker) -> None:
        """Builds the filters. This is slow: call it before the arm moves."""
        self._tracker, self._none = tracker, np.zeros(dimension)
        self._estimate, self._rival = RandomWalk(dimension, tracker), RandomWalk(dimension, tracker)
        self.outliers = self.jumps = 0

    def measure(self, difference: Vector, time: float) -> bool:
        """Takes a difference, measured minus computed (dimension,); returns False if it is an outlier.

        Raises:
            Refusal: the sample is older than the last one, or farther than FARTHEST clamps.
        """
        if time <= self._estimate.time:
            early = self._estimate.time - time
            raise Refusal(Reason.OUT_OF_ORDER, early=f"{early:.3f}")
        far, most = float(np.linalg.norm(difference)), FARTHEST * self._tracker.clamp
        if far > most:
            raise Refusal(Reason.TIP_TOO_FAR, away=f"{far:.4g}", most=f"{most:.4g}")
        if time - self._estimate.time > self._tracker.hold:
            self._estimate.start(self._none, self._tracker.clamp, time)
        if self._estimate.fits(difference, time):
            self._estimate.update(difference, time)
        elif not self._rival_won(difference, time):
            self.outliers += 1
            return False
        self._rival.updates = 0
        return True

    def at(self, time: float) -> Vector:
        """Returns the bias to correct goals by (dimension,), at most a clamp long; zero once `hold` is over."""
        if not time - self._estimate.time <= self._tracker.hold:
            return self._none
        bias = self._estimate.bias
        return np.asarray(bias * min(1.0, self._tracker.clamp / max(float(np.linalg.norm(bias)), 1e-300)))

    @property
    def estimate(self) -> tuple[Vector, float] | None:
        """The estimate before clamping, shape (dimension,), and its standard deviation; None without samples."""
        return (self._estimate.bias, self._estimate.deviation) if self._estimate.updates else None

    def _rival_won(self, difference: Vector, time: float) -> bool:
        """Adds an outlier to the rival estimate; returns whether the rival has replaced the bias."""
        if self._rival.updates and self._rival.fits(difference, time):
            self._rival.update(difference, time)
        else:
            self._rival.start(difference, self._tracker.noise, time)
        if self._rival.updates < AGREEING:
            return False
        self._estimate, self._rival = self._rival, self._estimate
        self.jumps += 1
        return True
