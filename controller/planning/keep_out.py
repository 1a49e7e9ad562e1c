"""What the arm keeps clear of: the obstacles of its file, those sent since, and itself."""

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

REMEMBERED = 20_000  # stages


class CollisionError(ValueError):
    """A stage would touch something; the text says what."""


@dataclass(frozen=True, eq=False)
class KeepOutSet:
    """The obstacles from one change to the next, with what is known of stages among them. For any thread.

    Attributes:
        generation: grows with each change.
        clearance: of the whole arm.
        sent: the obstacles that were sent; those of the arm's file are not among them.
    """

    generation: int
    clearance: Clearance
    sent: Obstacles = NONE
    _known: dict[bytes, str | None] = field(init=False, default_factory=dict)

    @property
    def free(self) -> bool:
        """Whether there is nothing to keep clear of."""
        return self.clearance.free

    def touched(
        self, states: States, stages: Iterable[States], proceed: Callable[[], bool] = lambda: True
    ) -> str | None:
        """Returns what the first of stages touches, in words; None if all are clear.

        A stage that was not checked before takes up to a third of a second.

        Args:
            states: of the actuators before, shape (A,).
            stages: the states that each stage ends in, each of shape (A,).
            proceed: asked before each stage; if it says no, the rest is not checked.
        """
        for stage in () if self.free else stages:
            if not proceed():
                return None
            if (words := self._touched(states, stage)) is not None:
                return words
            states = stage
        return None

    def where(self, measured: Measured) -> str | None:
        """Returns what the arm touches where its actuators are measured (A,); None if nothing, or not known."""
        if self.free:
            return None
        try:
            standing = self.clearance.manipulator.configuration(measured)
        except ValueError:
            return None
        return self.clearance.where(standing)

    def sentence(self, measured: Measured | None) -> str:
        """Returns how many obstacles there are, and what the arm touches where it stands (A,)."""
        count = len(self.clearance.obstacles)
        said = f"keeping out of {count} {'region' if count == 1 else 'regions'}, {len(self.sent)} of them sent"
        words = None if measured is None else self.where(measured)
        return said if words is None else f"{said}; {words} where the arm stands"

    def _touched(self, states: States, stage: States) -> str | None:
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
    """The one owner of the obstacles. For any thread.

    Attributes:
        current: replaced as a whole when the obstacles change.

    Args:
        arm: with the obstacles of its file.
    """

    def __init__(self, arm: Arm) -> None:
        self._arm, self._lock = arm, threading.Lock()
        self.current = KeepOutSet(0, arm.clearance())

    def change(self, sent: Obstacles) -> bool:
        """Takes other obstacles in place of those sent before; returns whether their content differs."""
        with self._lock:
            before = self.current
            if same(before.sent, sent):
                return False
            self.current = KeepOutSet(before.generation + 1, self._arm.clearance(others=sent), sent)
            return True


class CollisionAwareSolver:
    """A solver that keeps clear of the current obstacles. One thread's, but for `use`.

    Args:
        arm: the whole arm.
        solver: of it, or of the arm reduced by locked actuators.
        keep_out: the obstacles.
    """

    def __init__(self, arm: Arm, solver: Solver, keep_out: KeepOut) -> None:
        self._arm, self._base, self._keep_out = arm, solver, keep_out
        self._latest: tuple[Solver, KeepOutSet, Solver] | None = None

    def use(self, solver: Solver) -> None:
        """Takes another solver from now on."""
        self._base = solver

    def now(self) -> tuple[Solver, KeepOutSet]:
        """Returns the solver, and the obstacles that it keeps clear of."""
        base, current, latest = self._base, self._keep_out.current, self._latest
        if latest is None or latest[0] is not base or latest[1] is not current:
            aware = base if current.free else base.avoiding(self._clearance(base.manipulator, current))
            latest = self._latest = base, current, aware
        return latest[2], current

    def _clearance(self, manipulator: Manipulator, current: KeepOutSet) -> Clearance:
        same_arm = manipulator is current.clearance.manipulator
        return current.clearance if same_arm else self._arm.clearance(manipulator, current.sent)


def same(first: Obstacles, second: Obstacles) -> bool:
    """Returns whether two sets of obstacles have the same content."""
    arrays = ("kinds", "axes", "centres", "sizes")
    return first.names == second.names and all(
        np.array_equal(getattr(first, name), getattr(second, name)) for name in arrays
    )
