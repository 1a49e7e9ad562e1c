"""Measured tips from Zenoh, and the bias of the tip that goals are corrected by. Nothing moves because of one.

A tip counts where the arm has been at rest, in a known configuration, since before it was measured. As the latest only
waits to be read, more than fifty a second are not all read.
"""

import logging
import threading
import time
from collections.abc import Callable
from typing import Protocol

import numpy as np
import zenoh
from numpy.typing import NDArray

from controller.daemon.events import Payload
from controller.daemon.state import Mode
from controller.manipulator.manipulator import Configuration, Manipulator
from controller.motion.bias import DRIFT, TipBias, Tracker, decode
from controller.motion.codes import INVALID_GOAL, OLD_HEADER_TIMESTAMP, Refusal
from controller.settings import TrackerSettings

log = logging.getLogger(__name__)

Bias = NDArray[np.float64]

KEY = "measured_tip"
POLL = 0.02  # [s]
VALIDITY, SLACK = 1.0, 0.02  # [s] that a sample may be old, and that a tracker's clock may run ahead


class Resting(Protocol):
    """What is read of the control loop."""

    mode: Mode

    @property
    def commanded(self) -> Configuration | None:
        """The configuration, None while it is not known."""

    @property
    def free_at(self) -> float:
        """Since when it is settled [s on the loop's clock]."""


class TipWatch:
    """Takes measured tips in a thread of its own; bias, told and status are for any thread.

    Args:
        manipulator: the arm.
        settings: of the tracker.
        loop: that moves it.
        clock: of the loop [s].
        wall: UNIX time [s].
    """

    def __init__(
        self,
        manipulator: Manipulator,
        settings: TrackerSettings,
        loop: Resting,
        clock: Callable[[], float] = time.monotonic,
        wall: Callable[[], float] = time.time,
    ) -> None:
        """Builds the filter, which takes most of a second."""
        drift = settings.drift or DRIFT * settings.noise
        self._manipulator, self._loop, self._clock, self._wall = manipulator, loop, clock, wall
        self._filter = TipBias(manipulator.dimension, Tracker(settings.noise, settings.clamp, drift, settings.hold))
        self._received = self._accepted = self._refused = 0
        self._last_refusal: str | None = None
        self._lock, self._closing = threading.Lock(), threading.Event()
        self._thread: threading.Thread | None = None

    def listen(self, receive: Callable[[], zenoh.Sample | None]) -> None:
        """Starts the thread, which takes what `receive` returns."""
        self._thread = threading.Thread(target=self._run, args=(receive,), name="tip", daemon=True)
        self._thread.start()

    def close(self, timeout: float = 2.0) -> None:
        """Ends the thread."""
        self._closing.set()
        if self._thread is not None:
            self._thread.join(timeout)

    def _run(self, receive: Callable[[], zenoh.Sample | None]) -> None:
        while not self._closing.wait(POLL):
            try:
                sample = receive()
                if sample is not None and str(sample.key_expr).endswith(f"/{KEY}"):  # wildcards correct nothing
                    self.take(sample.payload.to_bytes())
            except Exception:
                log.exception("a measured tip was not taken")

    def take(self, payload: bytes) -> None:
        """Takes a measured tip that has arrived; what is wrong with one is only counted."""
        with self._lock:
            self._received += 1
            try:
                self._accepted += self._measure(payload)
            except Refusal as refusal:
                self._refused += 1
                self._last_refusal = str(refusal)

    def _measure(self, payload: bytes) -> bool:
        """Gives a measured tip to the filter, and returns whether it fits.

        Raises:
            Refusal: it is malformed, late, early, of a moving arm, or far from any tip that would be corrected.
        """
        position, stamp = decode(payload, self._manipulator.dimension)
        configuration, free_at, mode = self._loop.commanded, self._loop.free_at, self._loop.mode
        age = self._wall() - stamp
        if age > VALIDITY:
            raise Refusal(OLD_HEADER_TIMESTAMP, f"stamp: {age:.3f} s old on arrival, at most {VALIDITY:g} s are taken")
        if age < -SLACK:
            ahead = f"{-age:.3f} s in the future, at most {SLACK:g} s are taken"
            raise Refusal(INVALID_GOAL, f"stamp: {ahead}; stamps are UNIX seconds")
        measured_at = self._clock() - max(age, 0.0)
        if configuration is None or mode not in ("ready", "executing"):
            raise Refusal(INVALID_GOAL, f"the arm is {mode}, its configuration not known for sure")
        if measured_at < free_at:
            raise Refusal(INVALID_GOAL, "stamp: the arm was moving, or not yet settled")
        computed = self._manipulator.tip(configuration)[: len(position), 3]
        return self._filter.measure(position - computed, measured_at)

    def bias(self) -> Bias:
        """Returns what goals are corrected by, shape (dimension,)."""
        with self._lock:
            return self._filter.at(self._clock())

    def told(self) -> Payload:
        """Returns what `state` tells."""
        return {"bias": self.bias()}

    def status(self) -> Payload:
        """Returns how the estimate fares."""
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
                "bias": self._filter.at(self._clock()),
            }
