"""Estimates the tip bias from measured tips. A measured tip moves nothing.

A measured tip counts if the arm was at rest in a known configuration since before the measurement.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from controller.motion.bias import DRIFT, TipBias, Tracker, decode
from controller.motion.codes import INVALID_GOAL, OLD_HEADER_TIMESTAMP, Refusal
from controller.planning.core.events import Payload
from controller.planning.core.parts import Parts
from controller.settings import TrackerSettings

VALIDITY, SLACK = 1.0, 0.02  # greatest age of a sample [s], and greatest lead of a tracker's clock [s]


class TipBiasEstimator:
    """The tip bias, and counts of the measured tips.

    Args:
        parts: shared parts of the core.
        settings: of the tracker.
    """

    def __init__(self, parts: Parts, settings: TrackerSettings) -> None:
        """Builds the filter, which takes almost a second."""
        drift = settings.drift or DRIFT * settings.noise
        self._view, self._locks, self._manipulator = parts.view, parts.locks, parts.view.manipulator
        tracker = Tracker(settings.noise, settings.clamp, drift, settings.hold)
        self._filter = TipBias(self._manipulator.dimension, tracker)
        self._received = self._accepted = self._refused = 0
        self._last_refusal: str | None = None

    def take(self, payload: bytes, now: float, wall: float) -> None:
        """Takes a measured tip that has arrived; a refused one is only counted.

        Args:
            payload: JSON.
            now: monotonic time [s].
            wall: the same time [UNIX s].
        """
        self._received += 1
        try:
            self._accepted += self._measure(payload, now, wall)
        except Refusal as refusal:
            self._refused += 1
            self._last_refusal = str(refusal)

    def _measure(self, payload: bytes, now: float, wall: float) -> bool:
        """Passes a measured tip to the filter; returns False if it is an outlier.

        Raises:
            Refusal: the sample is malformed, late, early, of a moving arm, or too far from the computed tip.
        """
        position, stamp = decode(payload, self._manipulator.dimension)
        age = wall - stamp
        if age > VALIDITY:
            late = f"{age:.3f} s old on arrival, at most {VALIDITY:g} s are accepted"
            raise Refusal(OLD_HEADER_TIMESTAMP, f"stamp: {late}")
        if age < -SLACK:
            ahead = f"{-age:.3f} s in the future, at most {SLACK:g} s are accepted"
            raise Refusal(INVALID_GOAL, f"stamp: {ahead}; stamps are UNIX seconds")
        measured_at = now - max(age, 0.0)
        state, (mode, _) = self._view.state, self._locks.mode()
        configuration = None if state is None else state.configuration
        if state is None or configuration is None or mode not in ("ready", "executing"):
            raise Refusal(INVALID_GOAL, f"the arm is {mode}, or its configuration is not known")
        if state.snapshot.moving or measured_at < state.snapshot.free_at:
            raise Refusal(INVALID_GOAL, "stamp: the arm was moving, or not yet settled")
        computed = self._manipulator.tips(configuration[None])[0, : len(position), 3]
        return self._filter.measure(position - computed, measured_at)

    def bias(self, now: float) -> NDArray[np.float64]:
        """Returns the bias that corrects goals, shape (dimension,)."""
        return self._filter.at(now)

    def state_fields(self, now: float) -> Payload:
        """Returns the fields for `state`."""
        return {"bias": self.bias(now).tolist()}

    def status(self, now: float) -> Payload:
        """Returns the fields for `diagnostics`."""
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
            "bias": self.bias(now).tolist(),
        }
