"""What the arm keeps clear of: the regions of its file, those sent since the daemon began, and itself."""

import logging
import threading
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from controller.config import Arm
from controller.manipulator.manipulator import Manipulator
from controller.obstacles.clearance import Clearance
from controller.obstacles.regions import NONE, Regions
from controller.obstacles.sweep import sweep_of
from controller.search.solver import Solver
from drivers.faults import Fault

log = logging.getLogger(__name__)

States = NDArray[np.uint8]

REMEMBERED = 20_000  # stages
IN_OBSTACLE = "in-obstacle"  # code


class Unknown(Exception):
    """Whether stages touch anything is not known yet: it is being looked at, and to be asked again."""


@dataclass(frozen=True, eq=False)
class Kept:
    """What is kept clear of from one change to the next; from any thread.

    Attributes:
        clearance: of the whole arm.
        sent: the regions beside those of the arm's file.
    """

    clearance: Clearance
    sent: Regions = NONE
    _known: dict[bytes, str | None] = field(init=False, default_factory=dict)

    @property
    def free(self) -> bool:
        """Whether there is nothing to keep clear of."""
        return self.clearance.free

    def touched(self, states: States, stages: Iterable[States]) -> str | None:
        """Returns what the first of stages, each (A,), touches on the way from actuator states (A,) on; or None.

        Where nobody looked before, that takes up to a third of a second each.
        """
        for stage in () if self.free else stages:
            if (words := self._touched(states, stage)) is not None:
                return words
            states = stage
        return None

    def known(self, states: States, stages: Iterable[States]) -> str | None:
        """Returns what `touched` does, at once.

        Raises:
            Unknown: nobody has looked so far.
        """
        for stage in () if self.free else stages:
            words = self._known.get(key(states, stage), "")
            if words == "":
                raise Unknown
            if words is not None:
                return words
            states = stage
        return None

    def known_clear(self, states: States, stage: States) -> bool:
        """Returns whether a stage (A,) is known to touch nothing on the way from actuator states (A,) on: at once."""
        return self.free or self._known.get(key(states, stage), "") is None

    def where(self, measured: NDArray[np.int8]) -> str | None:
        """Returns what the arm touches where its actuators are measured (A,), None where that tells nothing."""
        try:
            standing = self.clearance.manipulator.configuration(measured)
        except ValueError:
            return None
        return self.clearance.where(standing)

    def _touched(self, states: States, stage: States) -> str | None:
        way = key(states, stage)
        if (known := self._known.get(way, "")) != "":
            return known
        try:
            sweep = sweep_of(self.clearance)
            touch = sweep.touch(states.astype(np.uint8), np.flatnonzero(states != stage))
            words = None if touch is None else sweep.words(touch)
        except Exception as error:
            log.exception("a stage cannot be looked at")
            words = f"nobody knows: {error!r}"
        if len(self._known) >= REMEMBERED:
            self._known.clear()
        self._known[way] = words
        return words


class Avoidance:
    """What is kept clear of now. The control loop's; `kept` may be read by any thread.

    Attributes:
        kept: see Kept; replaced as a whole.
        waits: how often the loop was told to ask again, once in each period that it waited.
    """

    def __init__(self, kept: Kept) -> None:
        self.kept = kept
        self.waits = 0
        self._looking: threading.Thread | None = None
        self._told: str | None = None

    def touched(self, states: States, stages: States) -> str | None:
        """Returns what stages (k, A) touch on the way from actuator states (A,) on, None for nothing; at once.

        What nobody has looked at is looked at in a thread, one question at a time. The answer is for whoever asks the
        same: it is kept under these stages, these states and what there is to keep clear of.

        Raises:
            Unknown: it is not known yet.
        """
        try:
            return self.kept.known(states, stages)
        except Unknown:
            if self._looking is None or not self._looking.is_alive():
                self._looking = self.judge(states, stages)
            self.waits += 1
            raise

    def judge(
        self,
        states: States,
        stages: Iterable[States],
        ended: Callable[[Kept, str | None], None] = lambda kept, touched: None,
    ) -> threading.Thread:
        """Has stages looked through, in a thread that tells what they touch, None for nothing."""
        kept = self.kept
        thread = threading.Thread(
            target=lambda: ended(kept, kept.touched(states, stages)), name="avoidance", daemon=True
        )
        thread.start()
        return thread

    def faults(self, measured: NDArray[np.int8]) -> tuple[Fault, ...]:
        """Returns what the arm touches where it stands (A,), as it is told in the state; it stops no arm."""
        words = None if self.kept.free else self.kept.where(measured)
        if words != self._told and words is not None:
            log.warning("the arm stands where it may not: %s", words)
        self._told = words
        if words is None:
            return ()
        return (Fault(IN_OBSTACLE, "arm", f"{words}: the arm holds, and goals are refused until that is changed"),)

    def sentence(self, measured: NDArray[np.int8]) -> str:
        """Returns how many regions there are, and what the arm touches where it stands (A,)."""
        count = len(self.kept.clearance.regions)
        said = f"keeping out of {count} {'region' if count == 1 else 'regions'}, {len(self.kept.sent)} of them sent"
        words = None if self.kept.free else self.kept.where(measured)
        return said if words is None else f"{said}; {words} where the arm stands"


class Guarded:
    """A solver that keeps clear of what is to be kept clear of now. One thread's, but for `use`.

    Args:
        arm: the whole arm.
        solver: of it, or of what is left by actuators that are held.
        avoidance: tells what is to be kept clear of.
    """

    def __init__(self, arm: Arm, solver: Solver, avoidance: Avoidance) -> None:
        self._arm, self._base, self._avoidance = arm, solver, avoidance
        self._latest: tuple[Solver, Kept, Solver] | None = None

    def use(self, solver: Solver) -> None:
        """Takes another solver from now on."""
        self._base = solver

    def now(self) -> tuple[Solver, Kept]:
        """Returns the solver, and what it keeps clear of."""
        base, kept, latest = self._base, self._avoidance.kept, self._latest
        if latest is None or latest[0] is not base or latest[1] is not kept:
            avoiding = base if kept.free else base.avoiding(self._of(base.manipulator, kept))
            latest = self._latest = base, kept, avoiding
        return latest[2], kept

    def _of(self, manipulator: Manipulator, kept: Kept) -> Clearance:
        same = manipulator is kept.clearance.manipulator
        return kept.clearance if same else self._arm.clearance(manipulator, kept.sent)


def key(states: States, stage: States) -> bytes:
    """Returns what stands for a stage (A,) that follows on actuator states (A,)."""
    return np.concatenate([states, stage]).astype(np.uint8).tobytes()


def keeping(arm: Arm, sent: Regions = NONE) -> Kept:
    """Returns what an arm keeps clear of with regions sent beside those of its file."""
    return Kept(arm.clearance(others=sent), sent)
