"""The arm as the planner knows it now: the latest snapshot, and the mode that `state` shows."""

import threading
import time
from collections.abc import Callable
from typing import Protocol

import numpy as np

from controller.manipulator.locked import transferred
from controller.manipulator.manipulator import Configuration, Manipulator
from controller.motion.codes import INVALID_GOAL, Refusal
from controller.motion.pacing import Pace
from controller.planning.arm_state import ArmState, Measured, RestClock
from controller.planning.link import ExecutorLink
from controller.program import Mode, Snapshot

NEWER_WITHIN = 0.2  # [s]; a snapshot comes 20 times a second


class Locks(Protocol):
    """What the mode depends on besides the executor: see LockedActuators."""

    problem: str | None

    @property
    def behind(self) -> bool:
        """Whether the planner's tables are being rebuilt."""

    def sentence(self) -> str:
        """Returns the locked actuators in words."""


class ArmMonitor:
    """Keeps the latest snapshot. `take` and `lost` are the link's thread's; all else is for any thread.

    Attributes:
        state: the arm at the latest snapshot; None while there is none.
        rest: when each actuator switched last.

    Args:
        manipulator: the whole arm.
        link: to the executor.
        travel: longest time of an actuator from end-stop to end-stop [s].
        pace: of the transitions.
        clock: monotonic time [s].
    """

    def __init__(
        self,
        manipulator: Manipulator,
        link: ExecutorLink,
        travel: float,
        pace: Pace,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.manipulator, self.clock = manipulator, clock
        self.state: ArmState | None = None
        self.rest = RestClock(len(manipulator.actuators), travel, pace)
        self._link, self._newer = link, threading.Condition()
        self._was_connected = False
        self._locks: Locks | None = None
        self._sentence, self._shown_for = "", ""

    def go_by(self, locks: Locks) -> None:
        """Takes the locked actuators into account from now on."""
        self._locks = locks

    # --- the link's thread

    def take(self, snapshot: Snapshot) -> ArmState:
        """Takes a snapshot."""
        state = ArmState(self.manipulator, snapshot)
        self.rest.note(self.state, state)
        with self._newer:
            self.state, self._was_connected = state, True
            self._note_reason(snapshot)
            self._newer.notify_all()
        return state

    def lost(self) -> None:
        """Notes that the executor is gone."""
        with self._newer:
            self.state, self._sentence = None, ""
            self._newer.notify_all()

    def ended(self, sentence: str) -> None:
        """Takes a sentence on the end of a program, which the mode shows until something else happens."""
        with self._newer:
            self._sentence, self._shown_for = sentence, ""

    # --- any thread

    @property
    def measured(self) -> Measured:
        """Measured states, -1 where they are not known, shape (A,)."""
        state = self.state
        return np.full(len(self.manipulator.actuators), -1, np.int8) if state is None else state.measured

    def mode(self) -> tuple[Mode, str]:
        """Returns the mode, and a sentence on it."""
        state, locks = self.state, self._locks
        if state is None:
            problem = self._link.problem or "waiting for the executor's first snapshot"
            return "fault" if self._was_connected else "starting", problem
        mode, reason = state.snapshot.mode, state.snapshot.reason
        if locks is not None and mode == "ready":
            if locks.problem is not None:
                return "fault", locks.problem
            if locks.behind:
                return "starting", f"planning is made ready to go on, {locks.sentence()}"
        if mode == "ready" and self._sentence:
            return mode, self._sentence
        return mode, reason

    def require(self, run: bool = True) -> ArmState:
        """Returns the latest state.

        Args:
            run: whether the arm is to move.

        Raises:
            Refusal: there is none, or the mode does not allow to move.
        """
        state, (mode, reason) = self.state, self.mode()
        if state is None or (run and mode not in ("ready", "executing")):
            raise Refusal(INVALID_GOAL, f"the arm is {mode}: {reason}")
        return state

    def start(self, state: ArmState, reduced: Manipulator) -> Configuration:
        """Returns the configuration to plan from (B,), of the arm reduced by its locked actuators.

        Raises:
            Refusal: the arm is in none, or not known, or other actuators are locked than the reduced arm has.
        """
        if (unknown := state.unknown_state) is not None:
            raise Refusal(INVALID_GOAL, f"unknown state: {unknown}; switch single actuators with `jog`")
        configuration = state.configuration
        if configuration is None:
            mode, reason = self.mode()
            raise Refusal(INVALID_GOAL, f"the arm is {mode}: {reason}")
        try:
            return transferred(configuration, self.manipulator, reduced)
        except ValueError:  # other actuators are locked now, and the tables do not know it yet
            mode, reason = self.mode()
            raise Refusal(INVALID_GOAL, f"the arm is {mode}: {reason}; which actuators are held changes now") from None

    def wait_newer(self, state: ArmState) -> None:
        """Waits until there is a newer snapshot, for a while at most."""
        with self._newer:
            self._newer.wait_for(lambda: self.state is not state, NEWER_WITHIN)

    def _note_reason(self, snapshot: Snapshot) -> None:
        """Forgets the sentence on the end of a program when something else has happened since."""
        if snapshot.mode == "ready":
            self._shown_for = self._shown_for or snapshot.reason
        if self._shown_for and (snapshot.mode != "ready" or snapshot.reason != self._shown_for):
            self._sentence = ""
