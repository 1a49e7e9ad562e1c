"""The locked actuators, and whether the planner's tables match them.

The executor owns which actuators are locked. The planner owns the tables, and knows which locks leave each module a
state.
"""

import logging
from collections.abc import Iterator
from functools import partial

import numpy as np

from hyperbit.controller.armfile.locks import lock_warning, locks_in_words
from hyperbit.controller.host.process import Log
from hyperbit.controller.manipulator.locked import require_states
from hyperbit.controller.motion.decoding.requests import DegradeMessage
from hyperbit.controller.planning.core.arm import ArmState
from hyperbit.controller.planning.core.parts import Parts
from hyperbit.controller.planning.core.tasks import Answer, BuildTables, Failed, Tables
from hyperbit.controller.program import Fault, Mode
from hyperbit.controller.refusals.reasons import Reason
from hyperbit.controller.refusals.refusal import Refusal, no_actuator


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
        if state.known and not state.snapshot.moving and (locked := state.locked_states) != self._locked:
            self._locked, self.problem = locked, None
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
