"""The executor's snapshots in the planner's terms: arrays over actuators, and the configuration that they spell."""

from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from controller.manipulator.locked import LockedStates, none_locked
from controller.manipulator.manipulator import Configuration, Manipulator
from controller.motion.pacing import Pace
from controller.motion.program import pack_states, unpack_states
from controller.program import Snapshot

States = NDArray[np.uint8]
Measured = NDArray[np.int8]  # actuator states, -1 unknown


def measured_states(measured: bytes, known: bytes, actuators: int) -> Measured:
    """Unpacks measured states to shape (A,); -1 where they are not known."""
    states = unpack_states(measured, actuators).astype(np.int8)
    return np.where(unpack_states(known, actuators) == 1, states, -1).astype(np.int8)


class ArmState:
    """The arm at one snapshot. Immutable; its arrays are computed at first use.

    Attributes:
        snapshot: as the executor sent it.
        manipulator: the whole arm.
    """

    def __init__(self, manipulator: Manipulator, snapshot: Snapshot) -> None:
        self.manipulator, self.snapshot = manipulator, snapshot

    @cached_property
    def outputs(self) -> States:
        """The boards' outputs, as last switched, shape (A,)."""
        return unpack_states(self.snapshot.outputs, len(self.manipulator.actuators))

    @cached_property
    def measured(self) -> Measured:
        """Measured states, shape (A,); -1 where they are not known."""
        return measured_states(self.snapshot.measured, self.snapshot.known, len(self.manipulator.actuators))

    @cached_property
    def sensed(self) -> NDArray[np.bool_]:
        """Which actuators have an end-stop, shape (A,)."""
        return unpack_states(self.snapshot.sensed, len(self.manipulator.actuators)).astype(np.bool_)

    @cached_property
    def locked(self) -> NDArray[np.bool_]:
        """Which actuators are locked, shape (A,)."""
        return unpack_states(self.snapshot.locked, len(self.manipulator.actuators)).astype(np.bool_)

    @cached_property
    def commanded(self) -> States:
        """The states from which stages begin, shape (A,): the outputs; for a locked actuator its locked state."""
        return np.where(self.locked & (self.measured >= 0), self.measured, self.outputs).astype(np.uint8)

    @cached_property
    def states(self) -> States:
        """The states to plan from, shape (A,).

        At rest these are the measured states, because an actuator may not have followed its output. While actuators
        travel, they are the commanded states.
        """
        if self.snapshot.moving:
            return self.commanded
        return np.where(self.measured >= 0, self.measured, self.commanded).astype(np.uint8)

    @cached_property
    def homing(self) -> NDArray[np.bool_]:
        """Which actuators have an unknown state, (A,); the executor homes them to their bit of `outputs` first."""
        actuators = len(self.manipulator.actuators)
        return unpack_states(self.snapshot.homing or bytes((actuators + 7) // 8), actuators).astype(np.bool_)

    @property
    def known(self) -> bool:
        """Whether each actuator's state is known or will be homed. It is not while a board is missing."""
        return bool(((self.measured >= 0) | self.homing).all())

    @cached_property
    def configuration(self) -> Configuration | None:
        """The configuration to plan from, shape (B,); None if the states spell none or are not known."""
        return self._spelled(self.states) if self.known else None

    @cached_property
    def unknown_state(self) -> str | None:
        """Why the arm at rest is in no configuration; None if it is in one, moves, or a board is missing."""
        if self.snapshot.moving or not self.known:
            return None
        try:
            self.manipulator.configuration(self.states)
        except ValueError as error:
            return f"what the boards measure is no configuration: {error}"
        return None

    @property
    def locked_states(self) -> LockedStates:
        """The state in which each actuator is locked, shape (A,); -1 if it is free or not known."""
        return np.where(self.locked, self.measured, none_locked(self.manipulator)).astype(np.int8)

    def pack(self, stages: States) -> list[bytes]:
        """Returns stages (k, A) packed for the executor, which sets the bits of locked actuators itself."""
        return pack_states(np.where(self.locked, self.outputs, stages).astype(np.uint8))

    def _spelled(self, states: States | Measured) -> Configuration | None:
        try:
            return self.manipulator.configuration(states)
        except ValueError:
            return None


class RestClock:
    """When each actuator switched last, according to the snapshots. The link's thread writes; any thread may read.

    Args:
        actuators: number of actuators.
        travel: longest time of an actuator from end-stop to end-stop [s].
        pace: of the transitions.
    """

    def __init__(self, actuators: int, travel: float, pace: Pace) -> None:
        self._switched_at = np.full(actuators, -np.inf)
        self._travel, self._pace = travel, pace

    def note(self, before: ArmState | None, state: ArmState) -> None:
        """Notes which actuators switched between two snapshots."""
        if before is not None and before.snapshot.outputs != state.snapshot.outputs:
            changed = before.outputs != state.outputs
            self._switched_at = np.where(changed, state.snapshot.at, self._switched_at)

    def ready(self, state: ArmState, stage: States, strict: bool) -> float:
        """Returns the earliest time of a stage (A,) [s]: the last stage has ended, and its actuators have rested."""
        differ, ready, switched_at = state.commanded != stage, -np.inf, self._switched_at
        if differ.any() and (self._pace.inrush is not None or strict):
            ready = switched_at.max() + self._travel
        if differ.any() and self._pace.rest > 0:
            ready = max(ready, switched_at[differ].max() + self._travel + self._pace.rest)
        return float(ready)
