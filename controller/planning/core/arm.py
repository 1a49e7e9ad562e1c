"""What the executor last said: its snapshot in the planner's terms, the mode, the connection, and locked actuators."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from functools import cached_property, partial
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from controller.armfile.locks import lock_warning, locks_in_words
from controller.host.process import Log
from controller.manipulator.locked import require_states
from controller.motion.decoding.requests import no_actuator
from controller.motion.stages.program import pack_states, unpack_states
from controller.planning.core.events import LockMessage
from controller.planning.core.parts import Parts
from controller.planning.core.tasks import Answer, ArmStart, BuildTables, Failed, Tables
from controller.program import Diagnostics, Fault, Mode, Settled, Snapshot, Welcome
from controller.refusals.reasons import Reason
from controller.refusals.refusal import Refusal, no_motion

if TYPE_CHECKING:
    from controller.manipulator.manipulator import Configuration, Manipulator
    from controller.motion.stages.pacing import Pace

States = NDArray[np.uint8]
Measured = NDArray[np.int8]  # actuator states, -1 unknown


def measured_states(measured: bytes, known: bytes, actuators: int) -> Measured:
    """Unpacks measured states to shape (A,); -1 where they are not known."""
    states = unpack_states(measured, actuators).astype(np.int8)
    return np.where(unpack_states(known, actuators) == 1, states, -1).astype(np.int8)


def packed(states: NDArray[np.generic]) -> bytes:
    """Returns actuator states (A,) in the executor's packing."""
    return np.packbits(states.astype(np.uint8), bitorder="little").tobytes()


class ArmState:
    """The arm at one snapshot. Immutable; its arrays are computed at first use."""

    def __init__(self, manipulator: Manipulator, snapshot: Snapshot) -> None:
        self.manipulator, self.snapshot = manipulator, snapshot

    @cached_property
    def outputs(self) -> States:
        """The boards' outputs, as last switched, shape (A,)."""
        return self.unpacked(self.snapshot.outputs)

    @cached_property
    def measured(self) -> Measured:
        """Measured states, shape (A,); -1 where they are not known."""
        return measured_states(self.snapshot.measured, self.snapshot.known, len(self.manipulator.actuators))

    @cached_property
    def sensed(self) -> NDArray[np.bool_]:
        """Which actuators have an end-stop, shape (A,)."""
        return self.unpacked(self.snapshot.sensed).astype(np.bool_)

    @cached_property
    def locked(self) -> NDArray[np.bool_]:
        """Which actuators are locked, shape (A,)."""
        return self.unpacked(self.snapshot.locked).astype(np.bool_)

    @cached_property
    def commanded(self) -> States:
        """The states from which stages begin, shape (A,): the outputs; for a locked actuator its locked state.

        While actuators travel, the arm is in these states at the end of the running stage.
        """
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
    def start(self) -> ArmStart:
        """Where a plan starts that is made now."""
        return ArmStart(self.snapshot.outputs, packed(self.commanded), packed(self.states), self.snapshot.locked)

    @cached_property
    def known(self) -> bool:
        """Whether each actuator's state is known or will be homed. It is not while a board is missing."""
        empty = bytes((len(self.manipulator.actuators) + 7) // 8)
        homing = self.unpacked(self.snapshot.homing or empty).astype(np.bool_)
        return bool(((self.measured >= 0) | homing).all())

    @cached_property
    def _spelled(self) -> Configuration | str | None:
        """The configuration to plan from, or why the states spell none; None if they are not known."""
        try:
            return self.manipulator.configuration(self.states) if self.known else None
        except ValueError as error:
            return f"what the boards measure is no configuration: {error}"

    @property
    def configuration(self) -> Configuration | None:
        """The configuration to plan from, shape (B,); None if the states spell none or are not known."""
        return None if isinstance(self._spelled, str) else self._spelled

    @property
    def unknown_state(self) -> str | None:
        """Why the arm at rest is in no configuration; None if it is in one, moves, or a board is missing."""
        return self._spelled if isinstance(self._spelled, str) and not self.snapshot.moving else None

    @property
    def locked_states(self) -> bytes:
        """The state in which each actuator is locked, as in `Tables`; 255 if it is free or not known."""
        return np.where(self.locked, self.measured, -1).astype(np.int8).tobytes()

    def pack(self, stages: States) -> list[bytes]:
        """Returns stages (k, A) packed for the executor, which sets the bits of locked actuators itself."""
        return pack_states(np.where(self.locked, self.outputs, stages).astype(np.uint8))

    def real(self, states: bytes) -> bytes:
        """Returns packed states of a stage with the states of locked actuators, for checks of collisions."""
        return packed(np.where(self.locked, self.commanded, self.unpacked(states)))

    def unpacked(self, states: bytes) -> States:
        """Returns packed states as an array, shape (A,)."""
        return unpack_states(states, len(self.manipulator.actuators))


class RestClock:
    """When each actuator switched last, according to the snapshots.

    Args:
        travel: longest time of an actuator from end-stop to end-stop [s].
    """

    def __init__(self, actuators: int, travel: float, pace: Pace) -> None:
        self._switched_at = np.full(actuators, -np.inf)
        self._travel, self._pace = travel, pace

    def note(self, before: ArmState | None, state: ArmState) -> None:
        """Notes which actuators switched between two snapshots."""
        if before is not None and before.snapshot.outputs != state.snapshot.outputs:
            changed = before.outputs != state.outputs
            self._switched_at = np.where(changed, state.snapshot.at, self._switched_at)

    def ready(self, state: ArmState, stage: bytes, strict: bool) -> float:
        """Returns the earliest time of a packed stage [s]: the last one has ended, and its actuators have rested."""
        waits, ready = self._pace.inrush is not None or strict, -np.inf
        if not waits and not self._pace.rest > 0:
            return ready
        differ, switched_at = state.commanded != state.unpacked(state.real(stage)), self._switched_at
        if differ.any() and waits:
            ready = switched_at.max() + self._travel
        if differ.any() and self._pace.rest > 0:
            ready = max(ready, switched_at[differ].max() + self._travel + self._pace.rest)
        return float(ready)


class ExecutorView:
    """What the executor last said, and whether it is connected.

    Attributes:
        state: the arm at the latest snapshot; None if there is none.
        diagnostics: the latest; None while not connected.
        instance: of the latest executor; None before the first connection.
        problem: why there is no connection.
        counted: switches of all actuators when the first executor was met; None before.
    """

    def __init__(self, manipulator: Manipulator, travel: float, pace: Pace) -> None:
        self.manipulator = manipulator
        self.state: ArmState | None = None
        self.diagnostics: Diagnostics | None = None
        self.instance: int | None = None
        self.connected, self.problem = False, "waiting for the executor"
        self.rest = RestClock(len(manipulator.actuators), travel, pace)
        self.counted: int | None = None
        self._was_connected = False
        self._sentence, self._shown_for = "", ""

    def welcome(self, message: Welcome, known: tuple[int, ...]) -> None:
        """Takes the greeting of an executor; `known` are the ledger's counts of switches."""
        self.instance, self.connected = message.instance, True
        self.problem = "waiting for the executor's first snapshot"
        if self.counted is None:
            self.counted = sum(map(max, known, message.counts)) if message.counts else sum(known)

    def take(self, snapshot: Snapshot) -> ArmState:
        """Stores a snapshot, and returns it as ArmState."""
        state = ArmState(self.manipulator, snapshot)
        self.rest.note(self.state, state)
        self.state, self._was_connected = state, True
        if snapshot.mode == "ready":
            self._shown_for = self._shown_for or snapshot.reason
        if self._shown_for and (snapshot.mode != "ready" or snapshot.reason != self._shown_for):
            self._sentence = ""
        return state

    def lost(self, reason: str) -> None:
        """Notes that there is no connection."""
        self.connected, self.problem = False, reason
        self.state = self.diagnostics = None
        self._sentence = ""

    def ended(self, sentence: str) -> None:
        """Sets the sentence on the end of a program; the mode shows it until the executor gives another reason."""
        self._sentence, self._shown_for = sentence, ""

    def measured_in(self, message: Settled) -> Measured:
        """Returns the measured states in a message, shape (A,); -1 where they are not known."""
        return measured_states(message.measured, message.known, len(self.manipulator.actuators))

    @property
    def measured(self) -> Measured:
        """Measured states, shape (A,); -1 where they are not known."""
        return np.full(len(self.manipulator.actuators), -1, np.int8) if self.state is None else self.state.measured

    def mode(self) -> tuple[Mode, str]:
        """Returns the executor's mode, and its reason as a sentence."""
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


class Locks:
    """The locked actuators of one arm, and the tables for them.

    The executor owns which actuators are locked. The planner owns the tables, and knows which locks leave each module
    a state.

    Attributes:
        problem: why the tables could not be rebuilt; None if they could.
    """

    def __init__(self, parts: Parts, tables: Tables) -> None:
        self._view, self._jobs, self._act = parts.view, parts.jobs, parts.act
        self._built, self._building = tables, False
        self._locked = tables.locked
        self.problem: str | None = None

    @property
    def states(self) -> NDArray[np.int8]:
        """Locked state of each actuator, 0 or 1; -1 if it is free; shape (A,)."""
        return np.frombuffer(self._locked, np.int8)

    @property
    def tables(self) -> Tables | None:
        """The tables for the present locks; None while they are rebuilt."""
        return self._built if self._built.locked == self._locked else None

    def mode(self) -> tuple[Mode, str]:
        """Returns the mode as users see it: the executor's, unless the tables do not allow goals."""
        mode, reason = self._view.mode()
        if mode == "ready" and self.problem is not None:
            return "fault", self.problem
        if mode == "ready" and self.tables is None:
            return "starting", f"the planner's tables are being rebuilt; {self.sentence()}"
        return mode, reason

    def update(self, state: ArmState) -> None:
        """Takes the locked actuators of a snapshot."""
        if state.known and not state.snapshot.moving and (locked := state.locked_states) != self._locked:
            self._locked, self.problem = locked, None
            self._act(Log(logging.WARNING, self.sentence()))
        self._rebuild()

    def retry(self) -> None:
        """Starts another attempt to rebuild the tables."""
        self.problem = None
        self._rebuild()

    def actuator(self, message: LockMessage, state: ArmState) -> int:
        """Returns the index of the actuator of a request; the executor decides on the rest.

        Raises:
            Refusal: it is no actuator of this arm, or a lock would leave a module no state.
        """
        labels = self._view.manipulator.actuators
        if message.actuator not in labels:
            raise no_actuator("actuator", message.actuator, labels)
        k, states = labels.index(message.actuator), self.states.copy()
        if message.state is None:
            return k  # also in states that are no configuration: a jog leaves them only with unlocked actuators
        states[k] = message.state
        if state.sensed[k] and state.measured[k] not in (-1, message.state):
            return k  # the executor refuses it, because the end-stop reads the other state
        try:
            require_states(self._view.manipulator, states)
            if (state.measured >= 0).all():
                held = np.where((states >= 0) & ~state.sensed, states, state.measured)
                self._view.manipulator.configuration(held)
        except ValueError as error:
            raise Refusal(Reason.MODULE_WITHOUT_STATE, error=str(error)) from None
        return k

    def faults(self) -> Iterator[Fault]:
        """Yields the faults for `state`: each locked actuator, and tables that could not be rebuilt."""
        for label, state in self._locks():
            yield Fault("degraded", label, lock_warning(label, state))
        if self.problem is not None:
            yield Fault("internal-error", "daemon", self.problem)

    def sentence(self) -> str:
        """Returns the locked actuators in words, e.g. "locked: 5.left (contracted)"."""
        return locks_in_words(self._locks())

    def _locks(self) -> Iterator[tuple[str, int]]:
        """Yields label and state of each locked actuator."""
        labels, states = self._view.manipulator.actuators, self.states
        return ((labels[k], int(states[k])) for k in np.flatnonzero(states >= 0))

    def _rebuild(self) -> None:
        """Starts a rebuild if one is needed and none runs."""
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
