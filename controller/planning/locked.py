"""Locked actuators: which actuators cannot move, in which state, and whether the planner's tables are up to date."""

import logging
import threading
from collections.abc import Callable, Iterator

import numpy as np
from numpy.typing import NDArray

from controller.manipulator.locked import STATES, LockedStates, lock_actuators
from controller.manipulator.manipulator import Manipulator
from controller.motion.requests import DegradeMessage
from controller.planning.arm_state import ArmState, Measured
from controller.program import Fault

log = logging.getLogger(__name__)


class LockedActuators:
    """The locked actuators of one arm, as the executor reports them, and the tables for them. For any thread.

    An end-stop reading overrides a declared state.

    Attributes:
        states: locked state of each actuator, 0 or 1; -1 if it is free; shape (A,).
        problem: why the tables could not be rebuilt; None if they could.

    Args:
        manipulator: the arm.
        declared: locked states from the arm's file, shape (A,).
        rebuild: rebuilds the planner's tables for locked states (A,). Takes seconds; runs in a worker thread.
        on_change: called when the tables are ready, or could not be built.
    """

    def __init__(
        self,
        manipulator: Manipulator,
        declared: LockedStates,
        rebuild: Callable[[LockedStates], None],
        on_change: Callable[[], None],
    ) -> None:
        self._manipulator, self._rebuild, self._on_change = manipulator, rebuild, on_change
        self.states = declared.copy()
        self.problem: str | None = None
        self._built = declared.copy()
        self._lock, self._working = threading.Lock(), False

    @property
    def rebuilding(self) -> bool:
        """Whether the tables are not up to date, or are being rebuilt."""
        return self._working or self.states.tobytes() != self._built.tobytes()

    def update(self, state: ArmState) -> None:
        """Takes the locked actuators of a snapshot; called in the link's thread, in order."""
        if not state.known or state.snapshot.moving:
            return
        with self._lock:
            states = state.locked_states
            if not np.array_equal(states, self.states):
                self.states, self.problem = states, None
                log.warning("%s", self.sentence())
        self._rebuild_if_needed()

    def retry(self) -> None:
        """Starts another attempt to rebuild the tables."""
        self.problem = None
        self._rebuild_if_needed()

    def refusal(self, request: DegradeMessage, measured: Measured, sensed: NDArray[np.bool_]) -> str | None:
        """Returns why a request is refused, or None.

        Args:
            request: the request.
            measured: actuator states, -1 unknown, shape (A,).
            sensed: which actuators have an end-stop, shape (A,).
        """
        labels = self._manipulator.actuators
        if request.actuator not in labels:
            known = f"{labels[0]} to {labels[-1]}"
            return f"actuator: {request.actuator[:40]!r} is no actuator of this arm; they are {known}"
        k = labels.index(request.actuator)
        if request.state is not None and sensed[k] and measured[k] not in (-1, request.state):
            return f"state: the end-stop of {request.actuator} reads {STATES[measured[k]]}"
        states = self.states.copy()
        states[k] = -1 if request.state is None else request.state
        try:
            lock_actuators(self._manipulator, states)
            if (measured >= 0).all():
                self._manipulator.configuration(np.where((states >= 0) & ~sensed, states, measured))
        except ValueError as error:
            return f"state: {error}"
        return None

    def faults(self) -> Iterator[Fault]:
        """Yields the faults for `state`: each locked actuator, and tables that could not be rebuilt."""
        labels = self._manipulator.actuators
        for k in np.flatnonzero(self.states >= 0):
            state = STATES[self.states[k]]
            yield Fault("degraded", labels[k], f"actuator {labels[k]} is locked {state}: plans do not switch it")
        if self.problem is not None:
            yield Fault("internal-error", "daemon", self.problem)

    def sentence(self) -> str:
        """Returns the locked actuators in words, e.g. "locked: 5.left (contracted)"."""
        labels, states = self._manipulator.actuators, self.states
        names = [f"{labels[k]} ({STATES[states[k]]})" for k in np.flatnonzero(states >= 0)]
        return f"locked: {', '.join(names)}" if names else "no actuator is locked"

    def _rebuild_if_needed(self) -> None:
        """Starts a rebuild if one is needed and none runs."""
        with self._lock:
            if self._working or self.problem is not None or np.array_equal(self.states, self._built):
                return
            self._working = True
            states = self.states.copy()
        threading.Thread(target=self._run_rebuild, args=(states,), name="rebuild", daemon=True).start()

    def _run_rebuild(self, states: LockedStates) -> None:
        problem = None
        try:
            if not np.array_equal(states, self._built):
                self._rebuild(states)
        except Exception as error:
            log.exception("the tables for the locked actuators cannot be rebuilt")
            problem = f"the tables for the locked actuators cannot be rebuilt: {error!r}; reset to try again"
        with self._lock:
            self._working = False
            if problem is None:
                self._built = states
            elif np.array_equal(states, self.states):
                self.problem = problem
        self._on_change()
        self._rebuild_if_needed()
