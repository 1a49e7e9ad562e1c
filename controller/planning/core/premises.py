"""The premises of plans: arm, tables, obstacles, and the tip bias, which is estimated from measured tips."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hyperbit.controller.armfile.settings import TrackerSettings
from hyperbit.controller.motion.tracking.bias import DRIFT, TipBias, Tracker, decode
from hyperbit.controller.planning.core.arm import ExecutorView
from hyperbit.controller.planning.core.events import Payload
from hyperbit.controller.planning.core.locks import Locks
from hyperbit.controller.planning.core.obstacles import ObstacleOwner
from hyperbit.controller.planning.core.parts import Parts
from hyperbit.controller.planning.core.tasks import Basis
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
        drift = settings.drift or DRIFT * settings.noise
        tracker = Tracker(settings.noise, settings.clamp, drift, settings.hold)
        self._filter = TipBias(parts.view.manipulator.dimension, tracker)
        self._counts = {"received": 0, "accepted": 0, "refused": 0}
        self._last_refusal: str | None = None

    def receive_tip(self, payload: bytes) -> None:
        """Handles a measured tip, as JSON; a refused one is only counted."""
        self._counts["received"] += 1
        try:
            self._counts["accepted"] += self._measure(payload)
        except Refusal as refusal:
            self._counts["refused"] += 1
            self._last_refusal = str(refusal)

    def _measure(self, payload: bytes) -> bool:
        """Passes a measured tip to the filter, or refuses it; returns False if it is an outlier."""
        manipulator = self._view.manipulator
        position, stamp = decode(payload, manipulator.dimension)
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
        computed = manipulator.tips(configuration[None])[0, : len(position), 3]
        return self._filter.measure(position - computed, measured_at)

    def bias(self) -> NDArray[np.float64]:
        return self._filter.at(self._moment.now)

    def status(self) -> Payload:
        estimate, deviation = self._filter.estimate or (None, None)
        return {
            **self._counts,
            "last_refusal": self._last_refusal,
            "outliers": self._filter.outliers,
            "jumps": self._filter.jumps,
            "estimate": None if estimate is None else estimate.tolist(),
            "deviation": deviation,
            "bias": self.bias().tolist(),
        }


class Premises(NamedTuple):
    view: ExecutorView
    locks: Locks
    obstacles: ObstacleOwner
    tip_bias: TipBiasEstimator | None  # None: the arm has no tracker

    def basis(self) -> Basis | None:
        """Returns the premises of a plan made now; None while the arm, its tables or the obstacles are unknown."""
        state, tables, scene = self.view.state, self.locks.tables, self.obstacles.scene
        return None if state is None or tables is None or scene is None else Basis(state.start, tables, scene)

    def correction(self) -> tuple[float, ...] | None:
        """Returns the present tip bias as `dimension` numbers; None without a tracker."""
        return None if self.tip_bias is None else tuple(self.tip_bias.bias().tolist())
