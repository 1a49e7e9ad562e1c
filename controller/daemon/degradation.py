"""Actuators that are stuck or were declared so: which are held in what state, and whether planning goes by that."""

import logging
import threading
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from controller.daemon.events import Prepared
from controller.manipulator.held import STATES, Held, free, hold
from controller.manipulator.manipulator import Manipulator
from controller.motion.degrade import DegradeMessage
from drivers.faults import Fault

log = logging.getLogger(__name__)


class Degradation:
    """What is held, from the arm's file, from requests, or found stuck. The control loop's.

    What an end-stop reads comes before what anybody declared.

    Attributes:
        held: the state in which each actuator is held, -1 where it is free, shape (A,).
        continues: whether the arm goes on by itself without an actuator that is found stuck.

    Args:
        manipulator: the arm.
        held: what planning goes by at first; nothing if absent.
        continues: see above.
        prepare: has planning go by other states held, which takes long; called in a thread of its own.
    """

    def __init__(
        self,
        manipulator: Manipulator,
        held: Held | None = None,
        continues: bool = False,
        prepare: Callable[[Held], None] = lambda held: None,
    ) -> None:
        self._manipulator, self._prepare = manipulator, prepare
        self.held = free(manipulator) if held is None else held.copy()
        self.continues = continues
        self._prepared = self.held.copy()
        self._found: set[int] = set()
        self._running = False

    def found(self, fault: Fault) -> None:
        """Takes an actuator that was found stuck, if the arm goes on without it; `settle` tells in which state."""
        label = fault.source.partition(" ")[0]
        if self.continues and fault.code == "stuck" and label in self._manipulator.actuators:
            self._found.add(self._manipulator.actuators.index(label))

    def objection(self, wish: DegradeMessage, measured: NDArray[np.int8], sensed: NDArray[np.bool_]) -> str | None:
        """Returns what forbids to do as a message says, None if nothing does.

        Args:
            wish: the message.
            measured: actuator states, -1 unknown, shape (A,).
            sensed: which have an end-stop, shape (A,).
        """
        labels = self._manipulator.actuators
        if wish.actuator not in labels:
            return f"actuator: {wish.actuator[:40]!r} is none of this arm's, which are {labels[0]} to {labels[-1]}"
        k = labels.index(wish.actuator)
        if wish.state is not None and sensed[k] and measured[k] not in (-1, wish.state):
            return f"state: the end-stop of {wish.actuator} reads {STATES[measured[k]]}"
        held = self._changed(wish)
        try:
            hold(self._manipulator, held)
            if (measured >= 0).all():
                self._manipulator.configuration(np.where((held >= 0) & ~sensed, held, measured))
        except ValueError as error:
            return f"state: {error}"
        return None

    def take(self, wish: DegradeMessage) -> None:
        """Does as a message says that there is no objection to."""
        self._found.discard(self._manipulator.actuators.index(wish.actuator))
        self._change(self._changed(wish))

    def settle(self, measured: NDArray[np.int8], sensed: NDArray[np.bool_]) -> None:
        """Takes what was found stuck, and every held actuator that has an end-stop, as held in the state measured."""
        held = self.held.copy()
        held[list(self._found)] = measured[list(self._found)]
        self._found.clear()
        read = (held >= 0) & sensed & (measured >= 0)
        self._change(np.where(read, measured, held).astype(np.int8))

    @property
    def behind(self) -> bool:
        """Whether planning does not go by what is held, or is about to go by something else."""
        return self._running or not np.array_equal(self.held, self._prepared)

    def begin(self, ended: Callable[[Prepared], None]) -> None:
        """Has planning go by what is held, in a thread that tells the end of it; one at a time."""
        if not self._running:
            self._running = True
            threading.Thread(target=self._work, args=(self.held.copy(), ended), name="degradation", daemon=True).start()

    def end(self, event: Prepared) -> None:
        """Notes the end of it."""
        self._running = False
        if event.fault is None:
            self._prepared = event.held

    def faults(self) -> tuple[Fault, ...]:
        """Returns what is held, as it is told in the state; it stops no arm."""
        labels = self._manipulator.actuators
        return tuple(
            Fault("degraded", labels[k], f"actuator {labels[k]} is held {STATES[self.held[k]]}: plans leave it so")
            for k in np.flatnonzero(self.held >= 0)
        )

    def sentence(self) -> str:
        """Returns what is held in words, as "5.left (contracted)", or that nothing is."""
        labels = self._manipulator.actuators
        held = [f"{labels[k]} ({STATES[self.held[k]]})" for k in np.flatnonzero(self.held >= 0)]
        return f"held: {', '.join(held)}" if held else "no actuator held"

    def _changed(self, wish: DegradeMessage) -> Held:
        held = self.held.copy()
        held[self._manipulator.actuators.index(wish.actuator)] = -1 if wish.state is None else wish.state
        return held

    def _change(self, held: Held) -> None:
        before, self.held = self.held, held
        if not np.array_equal(before, held):
            log.warning("%s", self.sentence())

    def _work(self, held: Held, ended: Callable[[Prepared], None]) -> None:
        try:
            self._prepare(held)
        except Exception as error:
            log.exception("planning cannot go by what is held")
            ended(Prepared(held, Fault("internal-error", "daemon", f"planning cannot go by what is held: {error!r}")))
        else:
            ended(Prepared(held))
