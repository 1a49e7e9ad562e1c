"""The tip bias, estimated from measured tips."""

import numpy as np
from numpy.typing import NDArray

from hyperbit.controller.armfile.settings import TrackerSettings
from hyperbit.controller.motion.tracking.bias import DRIFT, TipBias, Tracker, decode
from hyperbit.controller.planning.core.events import Payload
from hyperbit.controller.planning.core.locks import Locks
from hyperbit.controller.planning.core.parts import Parts
from hyperbit.controller.refusals.reasons import Reason
from hyperbit.controller.refusals.refusal import Refusal

VALIDITY, SLACK = 1.0, 0.02  # greatest age of a measured tip [s], and greatest lead of a tracker's clock [s]


class TipBiasEstimator:
    """Estimates the tip bias, and counts measured tips. A measured tip moves nothing.

    A measured tip counts if the arm was at rest in a known configuration since before the measurement.
    """

    def __init__(self, parts: Parts, locks: Locks, settings: TrackerSettings) -> None:
        """Builds the filter, which takes almost a second."""
        self._view, self._moment, self._locks = parts.view, parts.moment, locks
        self._manipulator = parts.view.manipulator
        drift = settings.drift or DRIFT * settings.noise
        tracker = Tracker(settings.noise, settings.clamp, drift, settings.hold)
        self._filter = TipBias(self._manipulator.dimension, tracker)
        self._received = self._accepted = self._refused = 0
        self._last_refusal: str | None = None

    def receive_tip(self, payload: bytes) -> None:
        """Takes a measured tip that has arrived, as JSON; a refused one is only counted."""
        self._received += 1
        try:
            self._accepted += self._measure(payload)
        except Refusal as refusal:
            self._refused += 1
            self._last_refusal = str(refusal)

    def _measure(self, payload: bytes) -> bool:
        """Passes a measured tip to the filter, or refuses it; returns False if it is an outlier."""
        position, stamp = decode(payload, self._manipulator.dimension)
        age = self._moment.wall - stamp
        if age > VALIDITY:
            raise Refusal(Reason.STALE, age=f"{age:.3f}", most=VALIDITY)
        if age < -SLACK:
            raise Refusal(Reason.FROM_THE_FUTURE, ahead=f"{-age:.3f}", most=SLACK)
        measured_at = self._moment.now - max(age, 0.0)
        state, (mode, _) = self._view.state, self._locks.mode()
        configuration = None if state is None else state.configuration
        if state is None or configuration is None or mode not in ("ready", "executing"):
            raise Refusal(Reason.TIP_NOT_KNOWN, mode=mode)
        if state.snapshot.moving or measured_at < state.snapshot.free_at:
            raise Refusal(Reason.TIP_MOVING)
        computed = self._manipulator.tips(configuration[None])[0, : len(position), 3]
        return self._filter.measure(position - computed, measured_at)

    def bias(self) -> NDArray[np.float64]:
        """Returns the bias that corrects goals, shape (dimension,)."""
        return self._filter.at(self._moment.now)

    def status(self) -> Payload:
        estimate, deviation = self._filter.estimate or (None, None)
        return {
            "received": self._received,
            "accepted": self._accepted,
            "refused": self._refused,
            "last_refusal": self._last_refusal,
            "outliers": self._filter.outliers,
            "jumps": self._filter.jumps,
            "estimate": None if estimate is None else estimate.tolist(),
            "deviation": deviation,
            "bias": self.bias().tolist(),
        }
