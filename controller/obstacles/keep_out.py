"""Collision checks of stages, with the results of earlier checks among the same obstacles."""

import logging
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from hyperbit.controller.obstacles.clearance import BodyClearance
from hyperbit.controller.obstacles.obstacles import NONE, Obstacles
from hyperbit.controller.obstacles.sweep import sweep_of

log = logging.getLogger(__name__)

States = NDArray[np.uint8]

REMEMBERED = 20_000  # results of stage checks


@dataclass(frozen=True, eq=False)
class KeepOutSet:
    """The obstacles between two changes, with the results of stage checks among them. Thread-safe."""

    clearance: BodyClearance  # of the whole arm
    sent: Obstacles = NONE  # the obstacles that were sent, without those of the arm's file
    _known: dict[bytes, str | None] = field(init=False, default_factory=dict)

    @property
    def free(self) -> bool:
        """Whether there is nothing to collide with."""
        return self.clearance.free

    @property
    def actuators(self) -> int:
        return len(self.clearance.manipulator.actuators)

    def first_collision(
        self, states: States, stages: Iterable[States], proceed: Callable[[], object] = lambda: None
    ) -> str | None:
        """Returns the first collision of consecutive stages from states (A,), in words; None if all are clear.

        The first check of a stage takes up to a third of a second. `proceed` is called before each stage; it raises if
        the check is no longer needed.
        """
        for stage in () if self.free else stages:
            proceed()
            if (words := self._collision(states, stage)) is not None:
                return words
            states = stage
        return None

    def collision_at(self, measured: NDArray[np.int8] | States) -> str | None:
        """Returns the collision in measured states (A,), in words; None if there is none or a state is unknown."""
        if self.free:
            return None
        try:
            standing = self.clearance.manipulator.configuration(measured)
        except ValueError:
            return None
        return self.clearance.where(standing)

    def _collision(self, states: States, stage: States) -> str | None:
        key = np.concatenate([states, stage]).astype(np.uint8).tobytes()
        if (known := self._known.get(key, "")) != "":
            return known
        try:
            sweep = sweep_of(self.clearance)
            touch = sweep.first_collision(states.astype(np.uint8), np.flatnonzero(states != stage))
            words = None if touch is None else sweep.describe(touch)
        except Exception as error:
            log.exception("a stage cannot be checked for collisions")
            words = f"a collision check failed: {error!r}"
        if len(self._known) >= REMEMBERED:
            self._known.clear()
        self._known[key] = words
        return words
