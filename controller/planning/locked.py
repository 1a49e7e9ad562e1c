"""Locked actuators: which actuators cannot move, in which state, and whether the planner's tables know it yet."""

import logging
import threading
from collections.abc import Callable, Iterator

import numpy as np
from numpy.typing import NDArray

from controller.manipulator.locked import STATES, LockedStates, lock_actuators
from controller.manipulator.manipulator import Manipulator
from controller.motion.degrade import DegradeMessage
from controller.planning.arm_state import ArmState, Measured
from controller.program import Fault

log = logging.getLogger(__name__)


class LockedActuators:
    """The locked actuators of one arm, as the executor tells them, and the tables that go with them. For any thread.

    An end-stop reading overrides a declared state.

    Attributes:
        states: the state in which each actuator is locked, 0 or 1; -1 if it is free; shape (A,).
        problem: why the tables could not be rebuilt; None if they could.

    Args:
        manipulator: the arm.
        declared: the states in which actuators are locked by the arm's file, shape (A,).
        rebuild: rebuilds the planner's tables for locked states (A,). Takes seconds; runs in a worker thread.
        changed: called when the tables are ready, or cannot be built.
    """

    def __init__(
        self,
        manipulator: Manipulator,
        declared: LockedStates,
        rebuild: Callable[[LockedStates], None],
        changed: Callable[[], None],
    ) -> None:
        self._manipulator, self._rebuild, self._changed = manipulator, rebuild, changed
        self.states = declared.copy()
        self.problem: str | None = None
        self._built = declared.copy()
        self._lock, self._working = threading.Lock(), False

    @property
    def behind(self) -> bool:
        """Whether the tables are not those of the locked actuators, or are being rebuilt."""
        return self._working or self.states.tobytes() != self._built.tobytes()

    def update(self, state: ArmState) -> None:
        """Takes the locked actuators of a snapshot; called in the link's thread, in the order of the snapshots."""
        if not state.known or state.snapshot.moving:
            return
        with self._lock:
            states = state.locked_states
            if not np.array_equal(states, self.states):
                self.states, self.problem = states, None
                log.warning("%s", self.sentence())
        self._go_on()

    def retry(self) -> None:
        """Tries once more to rebuild tables that could not be rebuilt."""
        self.problem = None
        self._go_on()

    def refusal(self, wish: DegradeMessage, measured: Measured, sensed: NDArray[np.bool_]) -> str | None:
        """Returns why a request is refused, or None.

        Args:
            wish: the request.
            measured: actuator states, -1 unknown, shape (A,).
            sensed: which actuators have an end-stop, shape (A,).
        """
        labels = self._manipulator.actuators
        if wish.actuator not in labels:
            return f"actuator: {wish.actuator[:40]!r} is none of this arm's, which are {labels[0]} to {labels[-1]}"
        k = labels.index(wish.actuator)
        if wish.state is not None and sensed[k] and measured[k] not in (-1, wish.state):
            return f"state: the end-stop of {wish.actuator} reads {STATES[measured[k]]}"
        states = changed(self._manipulator, self.states, wish)
        try:
            lock_actuators(self._manipulator, states)
            if (measured >= 0).all():
                self._manipulator.configuration(np.where((states >= 0) & ~sensed, states, measured))
        except ValueError as error:
            return f"state: {error}"
        return None

    def faults(self) -> Iterator[Fault]:
        """Yields what `state` tells: each locked actuator, and tables that could not be rebuilt."""
        labels = self._manipulator.actuators
        for k in np.flatnonzero(self.states >= 0):
            held = STATES[self.states[k]]
            yield Fault("degraded", labels[k], f"actuator {labels[k]} is held {held}: plans leave it so")
        if self.problem is not None:
            yield Fault("internal-error", "daemon", self.problem)

    def sentence(self, states: LockedStates | None = None) -> str:
        """Returns the locked actuators in words, as "held: 5.left (contracted)", or that there are none."""
        shown, labels = self.states if states is None else states, self._manipulator.actuators
        held = [f"{labels[k]} ({STATES[shown[k]]})" for k in np.flatnonzero(shown >= 0)]
        return f"held: {', '.join(held)}" if held else "no actuator held"

    def _go_on(self) -> None:
        """Starts a rebuild if one is needed and none runs."""
        with self._lock:
            if self._working or self.problem is not None or np.array_equal(self.states, self._built):
                return
            self._working = True
            states = self.states.copy()
        threading.Thread(target=self._work, args=(states,), name="rebuild", daemon=True).start()

    def _work(self, states: LockedStates) -> None:
        problem = None
        try:
            if not np.array_equal(states, self._built):
                self._rebuild(states)
        except Exception as error:
            log.exception("planning cannot go by what is held")
            problem = f"planning cannot go by what is held: {error!r}"
        with self._lock:
            self._working = False
            if problem is None:
                self._built = states
            elif np.array_equal(states, self.states):
                self.problem = problem
        self._changed()
        self._go_on()


def changed(manipulator: Manipulator, states: LockedStates, wish: DegradeMessage) -> LockedStates:
    """Returns locked states (A,) as a request changes them."""
    result = states.copy()
    result[manipulator.actuators.index(wish.actuator)] = -1 if wish.state is None else wish.state
    return result
