"""The set of obstacles: those of the arm's file, those sent since, and the arm itself."""

import logging
import threading
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from controller.config import Arm
from controller.manipulator.manipulator import Manipulator
from controller.obstacles.clearance import Clearance
from controller.obstacles.obstacles import NONE, Obstacles
from controller.obstacles.sweep import sweep_of
from controller.planning.arm_state import Measured
from controller.search.solver import Solver

log = logging.getLogger(__name__)

States = NDArray[np.uint8]

REMEMBERED = 20_000  # results of stage checks


class CollisionError(ValueError):
    """A stage would collide; the text says with what."""


@dataclass(frozen=True, eq=False)
class KeepOutSet:
    """The obstacles between two changes, with the results of stage checks among them. For any thread.

    Attributes:
        generation: grows with each change.
        clearance: of the whole arm.
        sent: the obstacles that were sent, without those of the arm's file.
    """

    generation: int
    clearance: Clearance
    sent: Obstacles = NONE
    _known: dict[bytes, str | None] = field(init=False, default_factory=dict)

    @property
    def free(self) -> bool:
        """Whether there is nothing to collide with."""
        return self.clearance.free

    def first_collision(
        self, states: States, stages: Iterable[States], proceed: Callable[[], bool] = lambda: True
    ) -> str | None:
        """Returns the first collision of consecutive stages, in words; None if all are clear.

        The first check of a stage takes up to a third of a second.

        Args:
            states: actuator states before, shape (A,).
            stages: actuator states after each stage, each of shape (A,).
            proceed: asked before each stage; if it returns False, the rest is not checked.
        """
        for stage in () if self.free else stages:
            if not proceed():
                return None
            if (words := self._collision(states, stage)) is not None:
                return words
            states = stage
        return None

    def collision_at(self, measured: Measured) -> str | None:
        """Returns the collision in measured states (A,), in words; None if there is none or a state is unknown."""
        if self.free:
            return None
        try:
            standing = self.clearance.manipulator.configuration(measured)
        except ValueError:
            return None
        return self.clearance.where(standing)

    def sentence(self, measured: Measured | None) -> str:
        """Returns the number of obstacles, and the collision in the present actuator states (A,), as a sentence."""
        count = len(self.clearance.obstacles)
        said = f"{count} {'obstacle' if count == 1 else 'obstacles'}, {len(self.sent)} of them sent"
        words = None if measured is None else self.collision_at(measured)
        return said if words is None else f"{said}; {words} where the arm stands"

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


class KeepOut:
    """The owner of the obstacles. For any thread.

    Attributes:
        current: the present set; replaced as a whole.

    Args:
        arm: with the obstacles of its file.
    """

    def __init__(self, arm: Arm) -> None:
        self._arm, self._lock = arm, threading.Lock()
        self.current = KeepOutSet(0, arm.clearance())

    def change(self, sent: Obstacles) -> bool:
        """Replaces the obstacles that were sent before; returns whether anything changed."""
        with self._lock:
            before = self.current
            if same_content(before.sent, sent):
                return False
            self.current = KeepOutSet(before.generation + 1, self._arm.clearance(others=sent), sent)
            return True


class CollisionAwareSolver:
    """A solver that avoids the present obstacles. Belongs to one thread; `use` is for any.

    Args:
        arm: the whole arm.
        solver: of the arm, or of the arm reduced by locked actuators.
        keep_out: the obstacles.
    """

    def __init__(self, arm: Arm, solver: Solver, keep_out: KeepOut) -> None:
        self._arm, self._base, self._keep_out = arm, solver, keep_out
        self._latest: tuple[Solver, KeepOutSet, Solver] | None = None

    def use(self, solver: Solver) -> None:
        """Sets the solver, from the next call of `now` on."""
        self._base = solver

    def now(self) -> tuple[Solver, KeepOutSet]:
        """Returns the solver, and the obstacles that it avoids."""
        base, current, latest = self._base, self._keep_out.current, self._latest
        if latest is None or latest[0] is not base or latest[1] is not current:
            aware = base if current.free else base.avoiding(self._clearance(base.manipulator, current))
            latest = self._latest = base, current, aware
        return latest[2], current

    def _clearance(self, manipulator: Manipulator, current: KeepOutSet) -> Clearance:
        same_arm = manipulator is current.clearance.manipulator
        return current.clearance if same_arm else self._arm.clearance(manipulator, current.sent)


def same_content(first: Obstacles, second: Obstacles) -> bool:
    """Returns whether two sets of obstacles have the same content."""
    arrays = ("kinds", "axes", "centres", "sizes")
    return first.names == second.names and all(
        np.array_equal(getattr(first, name), getattr(second, name)) for name in arrays
    )
