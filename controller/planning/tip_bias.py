"""Estimates the tip bias from measured tips. A measured tip moves nothing.

A measured tip counts if the arm was at rest in a known configuration since before the measurement. Only the latest one
waits to be read; above fifty a second, some are skipped.
"""

import logging
import threading
import time
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from controller.motion.bias import DRIFT, TipBias, Tracker, decode
from controller.motion.codes import INVALID_GOAL, OLD_HEADER_TIMESTAMP, Refusal
from controller.planning.admission import Receive
from controller.planning.messages import Payload
from controller.planning.monitor import ArmMonitor
from controller.settings import TrackerSettings

log = logging.getLogger(__name__)

POLL = 0.02  # [s]
VALIDITY, SLACK = 1.0, 0.02  # greatest age of a sample [s], and greatest lead of a tracker's clock [s]


class TipBiasWorker:
    """Takes measured tips in a thread of its own; `bias`, `state_fields` and `status` are for any thread.

    Args:
        monitor: of the arm.
        settings: of the tracker.
        wall: UNIX time [s].
    """

    def __init__(self, monitor: ArmMonitor, settings: TrackerSettings, wall: Callable[[], float] = time.time) -> None:
        """Builds the filter, which takes almost a second."""
        drift = settings.drift or DRIFT * settings.noise
        self._manipulator, self._monitor, self._wall = monitor.manipulator, monitor, wall
        tracker = Tracker(settings.noise, settings.clamp, drift, settings.hold)
        self._filter = TipBias(self._manipulator.dimension, tracker)
        self._received = self._accepted = self._refused = 0
        self._last_refusal: str | None = None
        self._receive: Receive = lambda: None
        self._lock, self._closing = threading.Lock(), threading.Event()
        self._thread = threading.Thread(target=self._run, name="tip-bias", daemon=True)

    def read(self, receive: Receive) -> None:
        """Sets the mailbox of measured tips: `receive` returns the latest, or None, and never waits."""
        self._receive = receive

    def start(self) -> None:
        """Starts the thread."""
        self._thread.start()

    def close(self, timeout: float = 2.0) -> None:
        """Ends the thread."""
        self._closing.set()
        self._thread.join(timeout)

    def _run(self) -> None:
        while not self._closing.wait(POLL):
            try:
                if (payload := self._receive()) is not None:
                    self.take(payload)
            except Exception:
                log.exception("a measured tip was not taken")

    def take(self, payload: bytes) -> None:
        """Takes a measured tip that has arrived; a refused one is only counted."""
        with self._lock:
            self._received += 1
            try:
                self._accepted += self._measure(payload)
            except Refusal as refusal:
                self._refused += 1
                self._last_refusal = str(refusal)

    def _measure(self, payload: bytes) -> bool:
        """Passes a measured tip to the filter; returns False if it is an outlier.

        Raises:
            Refusal: the sample is malformed, late, early, of a moving arm, or too far from the computed tip.
        """
        position, stamp = decode(payload, self._manipulator.dimension)
        state, (mode, _) = self._monitor.state, self._monitor.mode()
        age = self._wall() - stamp
        if age > VALIDITY:
            late = f"{age:.3f} s old on arrival, at most {VALIDITY:g} s are accepted"
            raise Refusal(OLD_HEADER_TIMESTAMP, f"stamp: {late}")
        if age < -SLACK:
            ahead = f"{-age:.3f} s in the future, at most {SLACK:g} s are accepted"
            raise Refusal(INVALID_GOAL, f"stamp: {ahead}; stamps are UNIX seconds")
        measured_at = self._monitor.clock() - max(age, 0.0)
        configuration = None if state is None else state.configuration
        if state is None or configuration is None or mode not in ("ready", "executing"):
            raise Refusal(INVALID_GOAL, f"the arm is {mode}, or its configuration is not known")
        if state.snapshot.moving or measured_at < state.snapshot.free_at:
            raise Refusal(INVALID_GOAL, "stamp: the arm was moving, or not yet settled")
        computed = self._manipulator.tip(configuration)[: len(position), 3]
        return self._filter.measure(position - computed, measured_at)

    def bias(self) -> NDArray[np.float64]:
        """Returns the bias that corrects goals, shape (dimension,)."""
        with self._lock:
            return self._filter.at(self._monitor.clock())

    def state_fields(self) -> Payload:
        """Returns the fields for `state`."""
        return {"bias": self.bias()}

    def status(self) -> Payload:
        """Returns the fields for `diagnostics`."""
        with self._lock:
            estimate, deviation = self._filter.estimate or (None, None)
            return {
                "received": self._received,
                "accepted": self._accepted,
                "refused": self._refused,
                "last_refusal": self._last_refusal,
                "outliers": self._filter.outliers,
                "jumps": self._filter.jumps,
                "estimate": estimate,
                "deviation": deviation,
                "bias": self._filter.at(self._monitor.clock()),
            }
