"""The set of obstacles: those of the arm's file, those sent since, and the arm itself."""

import threading

import numpy as np

from controller.config import Arm
from controller.manipulator.manipulator import Manipulator
from controller.obstacles.clearance import Clearance
from controller.obstacles.obstacles import Obstacles
from controller.planning.arm_state import Measured
from controller.planning.workers.keep_out import KeepOutSet
from controller.search.solver import Solver


class CollisionError(ValueError):
    """A stage would collide; the text says with what."""


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


def sentence(current: KeepOutSet, measured: Measured | None) -> str:
    """Returns the number of obstacles, and the collision in the present actuator states (A,), as a sentence."""
    count = len(current.clearance.obstacles)
    said = f"{count} {'obstacle' if count == 1 else 'obstacles'}, {len(current.sent)} of them sent"
    words = None if measured is None else current.collision_at(measured)
    return said if words is None else f"{said}; {words} where the arm stands"
