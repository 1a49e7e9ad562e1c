"""Switching the boards: never more actuators at once than may be, none before it has rested, each switch counted."""

import contextlib

import numpy as np
from numpy.typing import NDArray

from controller.daemon.avoidance import Avoidance
from controller.daemon.ledger import Ledger
from controller.manipulator.manipulator import Configuration, Manipulator
from controller.motion.bounded import split, step
from controller.motion.pacing import Pace
from drivers.boards import Boards
from drivers.faults import BusBusy, Leaving

BUSY_FOR = 0.25  # [s]; a bus that takes no frame for longer is a fault

States = NDArray[np.uint8]


class Touching(ValueError):
    """What was to be switched would touch something; the message says what."""


class Switching:
    """What the boards are commanded. The control loop's, called by no other thread.

    Attributes:
        commanded: configuration of `states`, None before they are known.
        states: actuator states last committed or adopted, shape (A,).
        switches: actuators switched since the daemon began.
        commits: by how many, as far as each was noted on its own.
        switched_at: when each switched last, shape (A,) [s].
        free_at: from when on the next stage may begin with the last one settled [s].
        busy_since: when the bus first took no frame, None if it took the last.

    Args:
        manipulator: the arm.
        boards: connected.
        travel: longest time of an actuator from end-stop to end-stop [s].
        pace: of the transitions.
        ledger: counts switches.
        avoidance: tells what is to be kept clear of.
    """

    def __init__(
        self, manipulator: Manipulator, boards: Boards, travel: float, pace: Pace, ledger: Ledger, avoidance: Avoidance
    ) -> None:
        self.commanded: Configuration | None = None
        self.states: States | None = None
        self.switches = self.commits = 0
        self.switched_at = np.full(len(manipulator.actuators), -np.inf)
        self.free_at = 0.0
        self.busy_since: float | None = None
        self._manipulator, self._boards, self._travel, self._ledger = manipulator, boards, travel, ledger
        self._pace, self._avoidance = pace, avoidance
        self._most = len(manipulator.actuators) if pace.inrush is None else pace.inrush

    def forget(self) -> None:
        """Takes the arm's configuration as unknown."""
        self.commanded = self.states = None

    def adopt(self, measured: NDArray[np.int8]) -> None:
        """Takes measured actuator states (A,) as the commanded ones; moves nothing.

        Raises:
            ValueError: they are no configuration of the arm.
        """
        self.commanded = self._manipulator.configuration(measured)
        self.states = measured.astype(np.uint8)
        self._ledger.resolve(self._boards.outputs())  # what was under way when the boards or the last daemon were lost

    def from_here(self, stages: States) -> States:
        """Returns the stages (k, A) by which a planned transition is carried out from the states as they are.

        Those that keep clear of something stay as they were planned, in which actuators may switch to and fro.

        Raises:
            Unknown: whether they do is not known yet.
        """
        rows = np.vstack([self._boards.outputs(), stages]).astype(int)
        fit = abs(np.diff(rows, axis=0)).sum(axis=1).max() <= self._most
        if fit and not self._avoidance.kept.free and self.touched(stages) is None:
            return stages
        return split(self._manipulator, self._boards.outputs(), stages, self._most)

    def ready(self, states: States) -> float:
        """Returns from when on states (A,) may be switched to [s]: the last stage has ended, the actuators rested."""
        differ, ready = self._boards.outputs() != states, -np.inf
        if differ.any() and not (self._pace.inrush is None and self._avoidance.kept.free):
            ready = self.switched_at.max() + self._travel
        if differ.any() and self._pace.rest > 0:
            ready = max(ready, self.switched_at[differ].max() + self._travel + self._pace.rest)
        return float(ready)

    def toward(self, stages: States, now: float) -> int | None:
        """Switches to the last of the stages (k, A) that the bound allows to be reached at once, or on the way there.

        Returns:
            The stage that has been reached; None: none yet, to be tried again with the next tick.

        Raises:
            BusBusy: the bus has taken no frame for too long.
            Touching: something would be touched on the way.
            Unknown: whether something would be is not known yet, to be tried again with the next tick.
        """
        if self.note(now):  # a SYNC has left late: the arm is on its way
            return None
        wanted, strict = self._next(stages), not self._avoidance.kept.free
        if now < self.ready(wanted) - 1e-9 or (strict and self._boards.moving(now)):
            return None
        begun = self._begun(wanted)
        if (begun != wanted).any() and (touched := self._avoidance.touched(begun, wanted[None])) is not None:
            raise Touching(touched)
        if not self._commit(wanted, now):
            return None
        reached = np.flatnonzero((stages == wanted).all(axis=1))
        return int(reached[-1]) if len(reached) else None

    def touched(self, stages: States) -> str | None:
        """Returns what stages (k, A) would touch on the way from the states as they are; None for nothing.

        Raises:
            Unknown: it is not known yet.
        """
        return self._avoidance.touched(self._boards.outputs(), stages)

    def fitting(self, stage: States) -> bool:
        """Returns whether a stage (A,) may be switched to at once, and is known to touch nothing on the way."""
        few = np.count_nonzero(self._boards.outputs() != stage) <= self._most
        return bool(few) and self._avoidance.kept.known_clear(self._begun(stage), stage)

    def _begun(self, stage: States) -> States:
        """Returns the states (A,) which differ from a stage (A,) where actuators may be on their way in it.

        Those are the ones that are switched, and those that are measured elsewhere, for they may come free.
        """
        measured = self._boards.measured()
        return np.where((measured >= 0) & (measured != stage), measured, self._boards.outputs()).astype(np.uint8)

    def _next(self, stages: States) -> States:
        outputs = self._boards.outputs()  # beside `states`, which may have been measured, and one of several buses busy
        for stage in stages[::-1]:
            if np.count_nonzero(outputs != stage) <= self._most:
                return np.asarray(stage, dtype=np.uint8)
        return step(self._manipulator, outputs, stages[-1], self._most)

    def note(self, now: float) -> int | None:
        """Counts what has switched and was not counted yet, perhaps by a SYNC that left late.

        Returns:
            How many have; None: it is not known yet, for a SYNC is still on its way, or a board not up.
        """
        if not self._boards.settle(now):
            return None
        outputs = self._boards.outputs()
        switched = self._ledger.resolve(outputs)
        self.switched_at[switched] = now
        self.switches += len(switched)
        if len(switched):
            self.commits += 1
            self.free_at = max(self.free_at, now + self._pace.lead)
        if len(switched) and self.states is not None:
            states = self.states.copy()
            states[switched] = outputs[switched]
            with contextlib.suppress(ValueError):  # of several buses one may have switched alone
                self.commanded, self.states = self._manipulator.configuration(states), states
        return len(switched)

    def _commit(self, states: States, now: float) -> bool:
        """Switches the actuators; returns False if the bus took no frame."""
        try:
            noted = self.note(now)
            if noted is None:  # what was intended last may still come about
                raise BusBusy("a SYNC is still on its way, or a board is lost")
            if noted:  # it just did: the arm is on its way
                return False
            self._ledger.intend(self._boards.outputs(), states)
            self._boards.commit(states, now)
        except Leaving:
            self.note(now)
            return False
        except BusBusy as error:
            self.note(now)
            if self.busy_since is None:
                self.busy_since = now
            if now - self.busy_since > BUSY_FOR:
                raise BusBusy(f"no command could be sent for {BUSY_FOR:g} s: {error}") from error
            return False
        self.note(now)
        self.busy_since, self.free_at = None, now + self._pace.lead
        self.states, self.commanded = states.copy(), self._manipulator.configuration(states)
        return True
