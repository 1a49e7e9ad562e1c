"""Dispatches the executor's messages to the parts of the planner. Runs in the link's thread and never waits."""

import contextlib
from collections.abc import Callable, Sequence
from typing import Protocol

from controller.motion.program import unpack_states
from controller.planning.admission import Admission
from controller.planning.clearance_worker import ClearanceWorker
from controller.planning.connection import NotConnected
from controller.planning.goals import RunningGoals
from controller.planning.link import ExecutorLink
from controller.planning.locked import LockedActuators
from controller.planning.monitor import ArmMonitor
from controller.planning.sending import ProgramNumbers
from controller.program import Counted, Counts, Diagnostics, Question, Snapshot, Up, Welcome


class CountLedger(Protocol):
    """Records switches; must not wait.

    Attributes:
        instance: of the executor, which the listener sets.
    """

    instance: int

    def counts(self, counts: Sequence[int]) -> None:
        """Takes the executor's counts, one for each actuator."""

    def known(self) -> Sequence[int]:
        """Returns the number of switches of each actuator so far."""


class ExecutorListener:
    """Dispatches each message.

    Attributes:
        counted: switches of all actuators when the first executor welcomed this planner; None before.

    Args:
        link: to the executor.
        monitor: takes snapshots.
        admission: takes epochs.
        goals: take the messages on programs.
        locked: takes the locked actuators.
        clearance: answers questions.
        numbers: of programs.
        ledger: of switches.
        on_change: called after each message that may change `state`.
    """

    def __init__(
        self,
        link: ExecutorLink,
        monitor: ArmMonitor,
        admission: Admission,
        goals: RunningGoals,
        locked: LockedActuators,
        clearance: ClearanceWorker,
        numbers: ProgramNumbers,
        ledger: CountLedger,
        on_change: Callable[[], None],
    ) -> None:
        self._link, self._monitor, self._admission, self._goals = link, monitor, admission, goals
        self._locked, self._clearance, self._numbers = locked, clearance, numbers
        self._ledger, self._on_change = ledger, on_change
        self.counted: int | None = None

    def welcomed(self, welcome: Welcome) -> None:
        """Continues the executor's program numbers, and sends it the ledger's counts."""
        self._numbers.at_least(welcome.program)
        self._ledger.instance = welcome.instance
        known = tuple(self._ledger.known())
        if self.counted is None:
            self.counted = sum(map(max, known, welcome.counts))
        with contextlib.suppress(NotConnected):
            self._link.send(Counts(known))
        self._on_change()

    def heard(self, message: Up) -> None:
        """Dispatches a message."""
        match message:
            case Snapshot():
                self._admission.snapshot(message.epoch)
                self._locked.update(self._monitor.take(message))
            case Counted() | Diagnostics():
                self._ledger.counts(message.counts)
                return
            case Question():
                actuators = len(self._monitor.manipulator.actuators)
                start, stage = (unpack_states(packed, actuators) for packed in (message.start, message.stage))
                self._clearance.ask(message, start, stage)
                return
            case _:
                self._goals.heard(message)
        self._on_change()

    def lost(self, reason: str) -> None:
        """Ends all running goals, as the executor is lost."""
        self._admission.lost()
        self._goals.lost(reason)
        self._monitor.lost()
        self._on_change()
