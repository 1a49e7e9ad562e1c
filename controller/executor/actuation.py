"""Actuation: the one owner of what the boards are commanded, of the bound on inrush, of rests and of counts."""

from typing import NamedTuple

from controller.executor.arm import ExecutedArm
from controller.executor.bits import indices
from controller.executor.switch_journal import SwitchJournal
from drivers.canopen.faults import Busy, Fault
from drivers.canopen.master import Master

BUSY_FOR = 0.25  # [s]; a bus that takes no command for longer is a fault


class Commit(NamedTuple):
    """The end of a commit.

    Attributes:
        states: that it was to bring about.
        reached: whether the outputs are these states.
    """

    states: int
    reached: bool


class Actuation:
    """Switches the outputs of the boards.

    Attributes:
        free_at: when the last switch has settled, by travel time [s].
        target: states of the commit under way; None if there is none.
        switches: actuators switched since the executor began.
        fault: the bus took no command for too long; taken by who reports it.

    Args:
        master: of the boards.
        arm: its times and bounds.
        journal: counts switches.
    """

    def __init__(self, master: Master, arm: ExecutedArm, journal: SwitchJournal) -> None:
        self.free_at = 0.0
        self.target: int | None = None
        self.switches = 0
        self.fault: Fault | None = None
        self._master, self._arm, self._journal = master, arm, journal
        self._switched_at = [-1e12] * len(arm.actuators)
        self._outputs: int | None = None  # as adopted, or switched since; None before the first time
        self._busy_since: float | None = None

    def ready_at(self, states: int, strict: bool) -> float:
        """Returns when states may be switched to [s]: the last stage has ended, and the actuators have rested."""
        differ = self._master.outputs ^ states
        ready = 0.0
        if differ and (strict or self._arm.inrush is not None):
            ready = self.free_at
        if differ and self._arm.rest > 0:
            last = max(self._switched_at[k] for k in indices(differ))
            ready = max(ready, last + self._arm.timing.travel_time + self._arm.rest)
        return ready

    def switch(self, states: int, now: float) -> bool:
        """Begins to switch to states; returns False if that is not possible now, to be tried again at the next tick."""
        if self.target is not None or self._master.committing:
            return False
        if not self._master.outputs_known:
            self._refused("a board is not up", now)
            return False
        self._journal.intend(self._master.outputs, states)
        try:
            self._master.commit(states, now)
        except Busy as error:
            self._journal.resolve(self._master.outputs)
            self._refused(str(error), now)
            return False
        self.target = states
        return True

    def switched(self, mask: int, now: float) -> None:
        """Notes that the SYNC of the actuators of a mask has left."""
        self._moved(mask, now)
        self._outputs = self._master.outputs
        self.switches += mask.bit_count()

    def conclude(self, now: float) -> Commit | None:
        """Counts the switches of the commit that was under way; None if it still is, or there was none."""
        if self.target is None or self._master.committing or not self._master.outputs_known:
            return None
        states, self.target = self.target, None
        self._journal.resolve(self._master.outputs)
        why = self._master.commit_failed
        if why is None:
            self._busy_since = None
        else:
            self._refused(why, now)
        return Commit(states, reached=self._master.outputs == states)

    def adopt(self, now: float) -> None:
        """Takes the outputs that the boards read back: counts what a commit before a fault or a start has switched.

        Actuators whose outputs have changed rest from now on; after a start all do, for the process before may have
        switched them just now.
        """
        self.target, self.fault = None, None
        outputs, everything = self._master.outputs, (1 << len(self._switched_at)) - 1
        self.switches += self._journal.resolve(outputs).bit_count()
        self._moved(everything if self._outputs is None else self._outputs ^ outputs, now)
        self._outputs = outputs
        self.rest()

    def rest(self) -> None:
        """Forgets how long the bus has been busy: nothing is to be switched."""
        self._busy_since = None

    def _moved(self, mask: int, now: float) -> None:
        """Notes that the actuators of a mask have begun to move."""
        if mask:
            self.free_at = max(self.free_at, now + self._arm.timing.travel_time)
        for k in indices(mask):
            self._switched_at[k] = now

    def _refused(self, why: str, now: float) -> None:
        if self._busy_since is None:
            self._busy_since = now
        if now - self._busy_since > BUSY_FOR:
            self.fault = Fault("bus-busy", "bus", f"no command could be sent for {BUSY_FOR:g} s: {why}")
            self._busy_since = None
