"""The present state of the arm: the latest snapshot, and the mode that `state` shows."""

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
    """What the mode depends on besides the executor; see LockedActuators."""

    problem: str | None

    @property
    def rebuilding(self) -> bool:
        """Whether the planner's tables are being rebuilt."""

    def sentence(self) -> str:
        """Returns the locked actuators in words."""


class ArmMonitor:
    """Stores the latest snapshot. `take` and `lost` are for the link's thread; all else is for any thread.

    Attributes:
        state: the arm at the latest snapshot; None if there is none.
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

    def set_locks(self, locks: Locks) -> None:
        """Sets the locked actuators on which the mode depends."""
        self._locks = locks

    # --- called by the link's thread

    def take(self, snapshot: Snapshot) -> ArmState:
        """Stores a snapshot, and returns it as ArmState."""
        state = ArmState(self.manipulator, snapshot)
        self.rest.note(self.state, state)
        with self._newer:
            self.state, self._was_connected = state, True
            self._note_reason(snapshot)
            self._newer.notify_all()
        return state

    def lost(self) -> None:
        """Notes that the executor is lost."""
        with self._newer:
            self.state, self._sentence = None, ""
            self._newer.notify_all()

    def ended(self, sentence: str) -> None:
        """Sets the sentence on the end of a program; the mode shows it until the executor gives another reason."""
        with self._newer:
            self._sentence, self._shown_for = sentence, ""

    # --- for any thread

    @property
    def measured(self) -> Measured:
        """Measured states, shape (A,); -1 where they are not known."""
        state = self.state
        return np.full(len(self.manipulator.actuators), -1, np.int8) if state is None else state.measured

    def mode(self) -> tuple[Mode, str]:
        """Returns the mode, and its reason as a sentence."""
        state, locks = self.state, self._locks
        if state is None:
            problem = self._link.problem or "waiting for the executor's first snapshot"
            return "fault" if self._was_connected else "starting", problem
        mode, reason = state.snapshot.mode, state.snapshot.reason
        if locks is not None and mode == "ready":
            if locks.problem is not None:
                return "fault", locks.problem
            if locks.rebuilding:
                return "starting", f"the planner's tables are being rebuilt; {locks.sentence()}"
        if mode == "ready" and self._sentence:
            return mode, self._sentence
        return mode, reason

    def require(self, run: bool = True) -> ArmState:
        """Returns the latest state.

        Args:
            run: whether the arm will move.

        Raises:
            Refusal: there is no snapshot, or the mode does not allow motion.
        """
        state, (mode, reason) = self.state, self.mode()
        if state is None or (run and mode not in ("ready", "executing")):
            raise Refusal(INVALID_GOAL, f"the arm is {mode}: {reason}")
        return state

    def start(self, state: ArmState, reduced: Manipulator) -> Configuration:
        """Returns the configuration to plan from (B,), of the arm reduced by its locked actuators.

        Raises:
            Refusal: the arm is in no known configuration, or the locked actuators have changed.
        """
        if (unknown := state.unknown_state) is not None:
            raise Refusal(INVALID_GOAL, f"unknown state: {unknown}; switch single actuators with `jog`")
        configuration = state.configuration
        if configuration is None:
            mode, reason = self.mode()
            raise Refusal(INVALID_GOAL, f"the arm is {mode}: {reason}")
        try:
            return transferred(configuration, self.manipulator, reduced)
        except ValueError:  # the locked actuators have changed, and the tables are not rebuilt yet
            mode, reason = self.mode()
            raise Refusal(
                INVALID_GOAL, f"the arm is {mode}: {reason}; the locked actuators are changing, send it again"
            ) from None

    def wait_newer(self, state: ArmState) -> None:
        """Waits for a newer snapshot, at most NEWER_WITHIN."""
        with self._newer:
            self._newer.wait_for(lambda: self.state is not state, NEWER_WITHIN)

    def _note_reason(self, snapshot: Snapshot) -> None:
        """Drops the sentence on the end of a program if mode or reason have changed since."""
        if snapshot.mode == "ready":
            self._shown_for = self._shown_for or snapshot.reason
        if self._shown_for and (snapshot.mode != "ready" or snapshot.reason != self._shown_for):
            self._sentence = ""
