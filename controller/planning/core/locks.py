"""Locked actuators as the executor reports them, and whether the planner's tables are built for them."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator
from functools import partial

import numpy as np
from numpy.typing import NDArray

from controller.manipulator.locked import STATES, require_states
from controller.motion.codes import INVALID_GOAL, Refusal
from controller.planning.core.arm import ArmState, ExecutorView
from controller.planning.core.events import Action, LockMessage, Log
from controller.planning.core.jobs import Jobs
from controller.planning.core.tasks import Answer, BuildTables, Failed, Tables, TablesBuilt
from controller.program import Fault, Mode


class Locks:
    """The locked actuators of one arm, and the tables for them.

    The executor owns which actuators are locked. The planner owns the tables, and knows which locks leave each module
    a state.

    Attributes:
        states: locked state of each actuator, 0 or 1; -1 if it is free; shape (A,).
        problem: why the tables could not be rebuilt; None if they could.

    Args:
        view: what the executor last said.
        jobs: starts tasks.
        tables: for the arm's file.
        act: takes actions.
    """

    def __init__(self, view: ExecutorView, jobs: Jobs, tables: Tables, act: Callable[[Action], None]) -> None:
        self._view, self._jobs, self._act = view, jobs, act
        self._built, self._building = tables, False
        self.states: NDArray[np.int8] = np.frombuffer(tables.locked, np.uint8).astype(np.int8)
        self.problem: str | None = None

    @property
    def tables(self) -> Tables | None:
        """The tables for the present locks; None while they are rebuilt."""
        return None if self.rebuilding else self._built

    @property
    def rebuilding(self) -> bool:
        """Whether the tables are not up to date."""
        return self._key() != self._built.locked

    def mode(self) -> tuple[Mode, str]:
        """Returns the mode as users see it: the executor's, unless the tables do not allow goals."""
        mode, reason = self._view.mode()
        if mode == "ready" and self.problem is not None:
            return "fault", self.problem
        if mode == "ready" and self.rebuilding:
            return "starting", f"the planner's tables are being rebuilt; {self.sentence()}"
        return mode, reason

    def update(self, state: ArmState) -> None:
        """Takes the locked actuators of a snapshot."""
        if state.known and not state.snapshot.moving and not np.array_equal(state.locked_states, self.states):
            self.states, self.problem = state.locked_states, None
            self._act(Log(logging.WARNING, self.sentence()))
        self._rebuild()

    def retry(self) -> None:
        """Starts another attempt to rebuild the tables."""
        self.problem = None
        self._rebuild()

    def actuator(self, message: LockMessage, state: ArmState) -> int:
        """Returns the index of the actuator of a request; the executor decides on the rest.

        Raises:
            Refusal: it is no actuator of this arm, or its module would have no state left.
        """
        labels = self._view.manipulator.actuators
        if message.actuator not in labels:
            known = f"{labels[0]} to {labels[-1]}"
            words = f"actuator: {message.actuator[:40]!r} is no actuator of this arm; they are {known}"
            raise Refusal(INVALID_GOAL, words)
        k, states = labels.index(message.actuator), self.states.copy()
        states[k] = -1 if message.state is None else message.state
        if message.state is not None and state.sensed[k] and state.measured[k] not in (-1, message.state):
            return k  # the executor refuses it, because the end-stop reads the other state
        try:
            require_states(self._view.manipulator, states)
            if (state.measured >= 0).all():
                held = np.where((states >= 0) & ~state.sensed, states, state.measured)
                self._view.manipulator.configuration(held)
        except ValueError as error:
            raise Refusal(INVALID_GOAL, f"state: {error}") from None
        return k

    def faults(self) -> Iterator[Fault]:
        """Yields the faults for `state`: each locked actuator, and tables that could not be rebuilt."""
        labels = self._view.manipulator.actuators
        for k in np.flatnonzero(self.states >= 0):
            state = STATES[self.states[k]]
            yield Fault("degraded", labels[k], f"actuator {labels[k]} is locked {state}: plans do not switch it")
        if self.problem is not None:
            yield Fault("internal-error", "daemon", self.problem)

    def sentence(self) -> str:
        """Returns the locked actuators in words, e.g. "locked: 5.left (contracted)"."""
        labels, states = self._view.manipulator.actuators, self.states
        names = [f"{labels[k]} ({STATES[states[k]]})" for k in np.flatnonzero(states >= 0)]
        return f"locked: {', '.join(names)}" if names else "no actuator is locked"

    def _key(self) -> bytes:
        return self.states.astype(np.uint8).tobytes()

    def _rebuild(self) -> None:
        """Starts a rebuild if one is needed and none runs."""
        if self.rebuilding and not self._building and self.problem is None:
            self._building = True
            task = BuildTables(self._built.generation + 1, self._key())
            self._jobs.start(task, partial(self._answered, task.locked))

    def _answered(self, locked: bytes, answer: Answer, last: bool, now: float) -> None:
        self._building = False
        if isinstance(answer, TablesBuilt):
            self._built = answer.tables
        elif isinstance(answer, Failed) and locked == self._key():
            words = f"the tables for the locked actuators cannot be rebuilt: {answer.reason}; reset to try again"
            self.problem = words
        self._rebuild()
