"""Tip bias: a filter of the difference between measured and computed tips.

The bias is measured minus computed position, in the world's frame. Causes are a base that has settled or an arm that
sags. The model is a random walk. Errors that depend on the configuration are corrected by calibration.
"""

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from msgspec import Meta, Struct
from numpy.typing import NDArray

from hyperbit.controller.armfile.fields import Angle, Coordinate
from hyperbit.controller.motion.decoding.goal import Time
from hyperbit.controller.motion.decoding.payloads import parse
from hyperbit.controller.motion.tracking.track import PointModel, Track
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


class TipBias:
    """The tip bias of one arm. The caller gives all times, in seconds of one clock."""

    def __init__(self, dimension: int, tracker: Tracker) -> None:
        """Builds the filters. This is slow: call it before the arm moves."""
        self._tracker, self._none = tracker, np.zeros(dimension)
        self.track = Track(dimension, PointModel(1, tracker.noise, tracker.drift, agreeing=AGREEING))

    def measure(self, difference: Vector, time: float) -> bool:
        """Takes a difference, measured minus computed (dimension,); returns False if it is an outlier.

        Raises:
            Refusal: the sample is older than the last one, or farther than FARTHEST clamps.
        """
        if time <= self.track.time:
            raise Refusal(Reason.OUT_OF_ORDER, early=f"{self.track.time - time:.3f}")
        far, most = float(np.linalg.norm(difference)), FARTHEST * self._tracker.clamp
        if far > most:
            raise Refusal(Reason.TIP_TOO_FAR, away=f"{far:.4g}", most=f"{most:.4g}")
        if time - self.track.time > self._tracker.hold:
            self.track.start(self._none, self._tracker.clamp, time)
        return self.track.measure(difference, time)

    def at(self, time: float) -> Vector:
        """Returns the bias to correct goals by (dimension,), at most a clamp long; zero once `hold` is over."""
        if not time - self.track.time <= self._tracker.hold:
            return self._none
        bias = self.track.predict(self.track.time).position
        return np.asarray(bias * min(1.0, self._tracker.clamp / max(float(np.linalg.norm(bias)), 1e-300)))

    @property
    def estimate(self) -> tuple[Vector, float] | None:
        """The estimate before clamping, shape (dimension,), and its standard deviation; None without samples."""
        if not self.track.begun:
            return None
        position, _, covariance = self.track.predict(self.track.time)
        return position, float(np.sqrt(covariance[0, 0]))
