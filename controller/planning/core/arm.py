"""The latest state of the executor: its snapshot in the planner's terms, the mode and the connection."""

from __future__ import annotations

from functools import cached_property
from operator import attrgetter
from typing import TYPE_CHECKING

import numpy as np
from msgspec import structs
from numpy.typing import NDArray

from hyperbit.controller.messages.arm import PlayableFault, Simulation
from hyperbit.controller.motion.stages.program import States, packed, unpack_states
from hyperbit.controller.planning.core.tasks import ArmStart
from hyperbit.controller.program import Diagnostics, Ended, Mode, Settled, Snapshot, Welcome
from hyperbit.controller.refusals.reasons import Reason
from hyperbit.controller.refusals.refusal import Refusal, no_motion

if TYPE_CHECKING:
    from hyperbit.controller.manipulator.manipulator import Configuration, Manipulator
    from hyperbit.controller.motion.stages.pacing import Pace

Measured = NDArray[np.int8]  # actuator states, -1 unknown

# The fields of a snapshot from which the arrays of an `ArmState` follow.
_of_actuators = attrgetter("outputs", "measured", "known", "sensed", "locked", "homing", "unread", "moving")


def measured_states(measured: bytes, known: bytes, actuators: int) -> Measured:
    """Unpacks measured states to shape (A,); -1 where they are unknown."""
    states = unpack_states(measured, actuators).astype(np.int8)
    return np.where(unpack_states(known, actuators) == 1, states, -1).astype(np.int8)


class ArmState:
    """The arm at one snapshot. Immutable; its arrays, of shape (A,), are computed at first use."""

    def __init__(self, manipulator: Manipulator, snapshot: Snapshot) -> None:
        self.manipulator, self.snapshot = manipulator, snapshot

    def at(self, snapshot: Snapshot) -> ArmState:
        """Returns the arm at a later snapshot, with the arrays of this one if no actuator has changed."""
        later = ArmState(self.manipulator, snapshot)
        if _of_actuators(snapshot) == _of_actuators(self.snapshot):
            vars(later).update(vars(self) | {"snapshot": snapshot})
        return later

    @cached_property
    def outputs(self) -> States:
        return self.unpacked(self.snapshot.outputs)

    @cached_property
    def measured(self) -> Measured:
        return measured_states(self.snapshot.measured, self.snapshot.known, len(self.manipulator.actuators))

    @cached_property
    def sensed(self) -> NDArray[np.bool_]:
        return self.unpacked(self.snapshot.sensed).astype(np.bool_)

    @cached_property
    def locked(self) -> NDArray[np.bool_]:
        return self.unpacked(self.snapshot.locked).astype(np.bool_)

    @cached_property
    def locked_states(self) -> bytes:
        """The measured states of locked actuators, one int8 each; -1 where an actuator is not locked."""
        return np.where(self.locked, self.measured, -1).astype(np.int8).tobytes()

    @cached_property
    def homing(self) -> NDArray[np.bool_]:
        """Which actuators have an unknown state until they are homed."""
        return self.unpacked(self.snapshot.homing).astype(np.bool_)

    @property
    def homed_first(self) -> list[str]:
        """Labels of the actuators that the next goal homes first, each with one switch."""
        return [self.manipulator.actuators[k] for k in np.flatnonzero(self.homing)]

    @cached_property
    def commanded(self) -> States:
        """The states from which stages begin: the outputs; for a locked actuator its locked state.

        While actuators travel, the arm is in these states at the end of the running stage.
        """
        return np.where(self.locked & (self.measured >= 0), self.measured, self.outputs).astype(np.uint8)

    @cached_property
    def states(self) -> States:
        """The states to plan from.

        At rest these are the measured states, because an actuator may not have followed its output. While actuators
        travel, they are the commanded states.
        """
        if self.snapshot.moving:
            return self.commanded
        return np.where(self.measured >= 0, self.measured, self.commanded).astype(np.uint8)

    @cached_property
    def start(self) -> ArmStart:
        return ArmStart(self.snapshot.outputs, packed(self.commanded), packed(self.states), self.snapshot.locked)

    @cached_property
    def unread(self) -> list[str]:
        """Labels of switched actuators whose state neither an end-stop nor a read has confirmed."""
        return [self.manipulator.actuators[k] for k in np.flatnonzero(self.unpacked(self.snapshot.unread))]

    @cached_property
    def known(self) -> bool:
        """Whether each actuator's state is known or will be homed. False while a board is missing."""
        return bool(((self.measured >= 0) | self.homing).all())

    @cached_property
    def _spelled(self) -> Configuration | str | None:
        """The configuration to plan from, or why the states form none; None if they are unknown."""
        try:
            return self.manipulator.configuration(self.states) if self.known else None
        except ValueError as error:
            return f"what the boards measure is no configuration: {error}"

    @property
    def configuration(self) -> Configuration | None:
        """The configuration to plan from, shape (B,); None if the states form none or are unknown."""
        return None if isinstance(self._spelled, str) else self._spelled

    @property
    def unknown_state(self) -> str | None:
        """Why the resting arm is in no configuration; None if it is in one, moves, or a board is missing."""
        return self._spelled if isinstance(self._spelled, str) and not self.snapshot.moving else None

    def unpacked(self, states: bytes) -> States:
        """Unpacks states to an array (A,); empty bytes mean zeros."""
        actuators = len(self.manipulator.actuators)
        return unpack_states(states, actuators) if states else np.zeros(actuators, np.uint8)


class ExecutorView:
    """The executor's latest state and connection; `travel` is the longest time of an actuator [s]."""

    def __init__(self, manipulator: Manipulator, travel: float, pace: Pace) -> None:
        self.manipulator = manipulator
        self.state: ArmState | None = None  # at the latest snapshot
        self.diagnostics: Diagnostics | None = None  # the latest; None while not connected
        self.instance: int | None = None  # of the latest executor; None before the first connection
        self.connected, self.problem = False, "waiting for the executor"  # the problem: why there is no connection
        self.counted: int | None = None  # switches of all actuators when the first executor was met
        self.simulation: Simulation | None = None  # of simulated boards, for `arm`; None: real boards, or no connection
        self._travel, self._pace = travel, pace
        self._switched_at = np.full(len(manipulator.actuators), -np.inf)  # time of the last switch, from snapshots [s]
        self._was_connected = False
        self._sentence, self._shown_for = "", ""

    def receive_welcome(self, message: Welcome, known: tuple[int, ...]) -> None:
        """Handles the greeting of an executor; `known` are the ledger's counts of switches."""
        self.instance, self.connected = message.instance, True
        self.problem, self.simulation = "waiting for the executor's first snapshot", None
        if (boards := message.simulation) is not None:
            faults = [PlayableFault(**structs.asdict(verb)) for verb in boards.faults]
            self.simulation = Simulation(faults, list(boards.boards), list(boards.buses), list(boards.interlocks))
        if self.counted is None:
            self.counted = sum(map(max, known, message.counts)) if message.counts else sum(known)

    def receive_snapshot(self, snapshot: Snapshot) -> ArmState:
        before = self.state
        state = ArmState(self.manipulator, snapshot) if before is None else before.at(snapshot)
        if before is not None and before.snapshot.outputs != snapshot.outputs:
            self._switched_at = np.where(before.outputs != state.outputs, snapshot.at, self._switched_at)
        self.state, self._was_connected = state, True
        if snapshot.mode == "ready":
            self._shown_for = self._shown_for or snapshot.reason
        if snapshot.mode != "executing" and (snapshot.mode != "ready" or snapshot.reason != self._shown_for):
            self._sentence = ""
        return state

    def lost(self, reason: str) -> None:
        self.connected, self.problem = False, reason
        self.state = self.diagnostics = self.simulation = None
        self._sentence = ""

    def ended(self, sentence: str) -> None:
        """Sets the sentence on the end of a program; the mode shows it until the executor gives another reason.

        An end reported before the first snapshot may be long past, so it is ignored.
        """
        if self.state is not None and self.state.snapshot.mode in ("executing", "ready"):
            self._sentence, self._shown_for = sentence, ""

    def ready_at(self, state: ArmState, stage: bytes, strict: bool) -> float:
        """Returns the earliest start of a packed stage [s]: the last one has ended, and its actuators have rested."""
        waits, rest, ready = self._pace.inrush is not None or strict, self._pace.rest, -np.inf
        if waits or rest > 0:
            differ = state.commanded != state.unpacked(state.start.real(stage))
            if differ.any() and waits:
                ready = self._switched_at.max() + self._travel
            if differ.any() and rest > 0:
                ready = max(ready, self._switched_at[differ].max() + self._travel + rest)
        return float(ready)

    def measured_in(self, message: Settled | Ended) -> Measured:
        return measured_states(message.measured, message.known, len(self.manipulator.actuators))

    @property
    def measured(self) -> Measured:
        return np.full(len(self.manipulator.actuators), -1, np.int8) if self.state is None else self.state.measured

    def mode(self) -> tuple[Mode, str]:
        if self.state is None:
            return "fault" if self._was_connected else "starting", self.problem
        snapshot = self.state.snapshot
        return snapshot.mode, self._sentence if snapshot.mode == "ready" and self._sentence else snapshot.reason


def obstruction(state: ArmState, mode: Mode, reason: str) -> Refusal | None:
    """Returns why no goal can be planned from a state, in the mode that users see; None if one can."""
    if state.unknown_state is not None:
        return Refusal(Reason.UNKNOWN_STATE, why=state.unknown_state)
    if state.known and state.configuration is None:
        return Refusal(Reason.STATE_IN_BETWEEN, why=reason)
    return no_motion(mode, reason) if state.configuration is None else None
