"""The premises of plans: arm, tables for the locked actuators, obstacles, and the tip bias from measured tips.

The executor owns which actuators are locked. The planner owns the tables, and knows which locks leave each module a
state.
"""

import logging
from collections.abc import Iterator
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hyperbit.controller.armfile.locks import lock_warning, locks_in_words
from hyperbit.controller.armfile.settings import TrackerSettings
from hyperbit.controller.host.process import Log
from hyperbit.controller.manipulator.locked import require_states
from hyperbit.controller.messages.state import TrackerStatus
from hyperbit.controller.motion.decoding.requests import DegradeMessage
from hyperbit.controller.motion.tracking.bias import DRIFT, TipBias, Tracker, decode
from hyperbit.controller.planning.core.arm import ArmState, ExecutorView
from hyperbit.controller.planning.core.obstacles import ObstacleOwner
from hyperbit.controller.planning.core.parts import Parts
from hyperbit.controller.planning.core.tasks import Answer, Basis, BuildTables, Failed, Tables
from hyperbit.controller.program import Fault, Mode
from hyperbit.controller.refusals.reasons import Reason
from hyperbit.controller.refusals.refusal import Refusal, no_actuator

VALIDITY, SLACK = 1.0, 0.02  # greatest age of a measured tip [s], and greatest lead of a tracker's clock [s]


class Locks:
    def __init__(self, parts: Parts, tables: Tables) -> None:
        self._view, self._jobs, self._act = parts.view, parts.jobs, parts.act
        self._built, self._building, self._locked = tables, False, tables.locked
        self.problem: str | None = None  # why the tables could not be rebuilt

    @property
    def listed(self) -> list[tuple[str, int]]:
        labels, states = self._view.manipulator.actuators, np.frombuffer(self._locked, np.int8).tolist()
        return [(label, state) for label, state in zip(labels, states, strict=True) if state >= 0]

    @property
    def tables(self) -> Tables | None:
        """The tables for the present locks; None while they are rebuilt."""
        return self._built if self._built.locked == self._locked else None

    @property
    def rebuilding(self) -> bool:
        """Whether goals can run as soon as the tables are rebuilt."""
        return self.tables is None and self.problem is None and self._view.mode()[0] == "ready"

    def mode(self) -> tuple[Mode, str]:
        """Returns the mode as users see it: the executor's, unless the tables do not allow goals."""
        mode, reason = self._view.mode()
        if mode == "ready" and self.problem is not None:
            return "fault", self.problem
        if mode == "ready" and self.tables is None:
            return "starting", f"the planner's tables are being rebuilt; {locks_in_words(self.listed)}"
        return mode, reason

    def update(self, state: ArmState) -> None:
        if state.known and not state.snapshot.moving and state.locked_states != self._locked:
            self._locked, self.problem = state.locked_states, None
            self._act(Log(logging.WARNING, locks_in_words(self.listed)))
        self._rebuild()

    def retry(self) -> None:
        self.problem = None
        self._rebuild()

    def actuator(self, message: DegradeMessage, state: ArmState) -> int:
        """Returns the index of the actuator, or raises Refusal; the executor decides the rest."""
        manipulator = self._view.manipulator
        if message.actuator not in manipulator.actuators:
            raise no_actuator("actuator", message.actuator, manipulator.actuators)
        k, states = manipulator.actuators.index(message.actuator), np.frombuffer(self._locked, np.int8).copy()
        if message.state is None:
            return k  # also in states that are no configuration: a jog leaves them only with unlocked actuators
        states[k] = message.state
        if state.sensed[k] and state.measured[k] not in (-1, message.state):
            return k  # the executor refuses it, because the end-stop reads the other state
        try:
            require_states(manipulator, states)
            if (state.measured >= 0).all():
                manipulator.configuration(np.where((states >= 0) & ~state.sensed, states, state.measured))
        except ValueError as error:
            raise Refusal(Reason.MODULE_WITHOUT_STATE, error=str(error)) from None
        return k

    def faults(self) -> Iterator[Fault]:
        for label, state in self.listed:
            yield Fault("degraded", label, lock_warning(label, state))
        if self.problem is not None:
            yield Fault("internal-error", "daemon", self.problem)

    def _rebuild(self) -> None:
        if self.tables is None and not self._building and self.problem is None:
            self._building = True
            task = BuildTables(self._built.generation + 1, self._locked)
            self._jobs.start(task, partial(self._answered, task.locked))

    def _answered(self, locked: bytes, answer: Answer) -> None:
        self._building = False
        if isinstance(answer, Tables):
            self._built = answer
        elif isinstance(answer, Failed) and locked == self._locked:
            reason = f"{answer.reason}; reset to try again"
            self.problem = f"the tables for the locked actuators cannot be rebuilt: {reason}"
        self._rebuild()


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

    def status(self) -> TrackerStatus:
        estimate, deviation = self._filter.estimate or (None, None)
        return TrackerStatus(
            **self._counts,
            last_refusal=self._last_refusal,
            outliers=self._filter.track.outliers,
            jumps=self._filter.track.jumps,
            estimate=None if estimate is None else estimate.tolist(),
            deviation=deviation,
            bias=self.bias().tolist(),
        )


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
