"""When the control loop tells of itself: its state 20 times a second and on change, diagnostics once a second."""

import time
from collections.abc import Callable

from controller.daemon.ledger import Ledger
from controller.daemon.runner import Runner
from controller.daemon.state import Diagnostics, LoopStatus, Mode, Snapshot, Telemetry
from controller.daemon.worries import Worries
from controller.manipulator.held import Held
from drivers.boards import Boards
from drivers.faults import Fault

STATE_EVERY = 0.05  # [s]
DIAGNOSTICS_EVERY = 1.0


class Teller:
    """Takes snapshots of the arm when they are due. The control loop's.

    Attributes:
        changed: whether something has that was not told yet.

    Args:
        boards: connected.
        runner: of the goals.
        ledger: of switches and goals.
        telemetry: takes the snapshots.
        reachable: whether anybody is connected of those that the daemon was told to connect to.
    """

    def __init__(
        self, boards: Boards, runner: Runner, ledger: Ledger, telemetry: Telemetry, reachable: Callable[[], bool]
    ) -> None:
        self.changed = True
        self._worries = Worries(boards, ledger, reachable)
        self._boards, self._runner, self._ledger, self._telemetry = boards, runner, ledger, telemetry
        self._next_state = self._next_diagnostics = 0.0

    def state_due(self, now: float) -> bool:
        """Returns whether the state is to be told."""
        return self.changed or now >= self._next_state

    def show(self, now: float, mode: Mode, reason: str, faults: tuple[Fault, ...], held: Held) -> None:
        """Tells the state."""
        self.changed, self._next_state = False, now + STATE_EVERY
        execution = self._runner.execution
        self._telemetry.show(
            Snapshot(
                stamp=time.time(),
                mode=mode,
                reason=reason,
                commanded=self._runner.switching.states,
                measured=self._boards.measured(),
                goal=execution.goal.id if execution else None,
                waypoint=execution.waypoint if execution and execution.waypoint >= 0 else None,
                faults=faults + self._worries.look(),
                held=held,
            )
        )

    def diagnostics_due(self, now: float) -> bool:
        """Returns whether diagnostics are to be told."""
        return now >= self._next_diagnostics

    def diagnose(self, now: float, status: LoopStatus, waiting: int) -> None:
        """Tells how the loop keeps time, how many events wait for it, and what is known of buses and boards."""
        self._next_diagnostics = now + DIAGNOSTICS_EVERY
        runner, hardware, ledger = self._runner, self._boards.status(), self._ledger.fault
        switches = runner.switching.switches
        self._telemetry.diagnose(Diagnostics(time.time(), status, hardware, waiting, switches, runner.waits, ledger))
