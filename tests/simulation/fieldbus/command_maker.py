"""What all makers of faults of a command have: the drawn command, and how it is sent."""

from __future__ import annotations

from typing import TYPE_CHECKING

from tests.simulation.fieldbus.fault_maker import FaultMaker
from tests.simulation.judge.verdict import require

if TYPE_CHECKING:
    from tests.simulation.fieldbus.world import BoardWorld

AT_ONCE = 0.05  # [s] until a failure is told
COMMITTED = 0.6  # [s] until a command must be over


class CommandMaker(FaultMaker):
    def __init__(self, world: BoardWorld) -> None:
        super().__init__(world)
        self._states = world.use.possible(
            world.random.getrandbits(world.wiring.lines.bit_length()) & world.wiring.lines
        )
        self._before = world.switching.states
        self._changed = self._before ^ self._states
        self._fit = bool(self._changed) and not self._before & world.wiring.pulsed

    def _commit(self, states: int) -> None:
        self._site.call(lambda m: m.commit(states, self._world.agenda.now))

    def _refused(self, states: int, why: type[Exception]) -> str:
        try:
            self._commit(states)
        except why as error:
            return str(error)
        require(False, f"a command of {states:b} is not refused by {why.__name__}")
        return ""

    def _waits(self) -> bool:
        """Returns whether all boards that the command switches wait for SYNC."""
        names = [n for n, b in self._world.wiring.boards.items()]
        return all(part.waits for name in names for part in self._world.switching.parts_of(name))

    def _unswitched(self, *why: str) -> None:
        """Requires that nothing has switched, and that the master says so."""
        master = self._world.master
        driven = self._world.switching.driven()
        require(
            driven == self._before,
            f"the pins are {driven:b} after a command that was given up; {self._before:b} before",
        )
        failed = master.commit_failed
        require(failed is not None and any(w in failed for w in why), f"the failure is {failed!r}, must be {why}")
        require(not master.drain_switched(), "switches of a command that was given up are told")
        require(master.outputs == self._before, f"outputs {master.outputs:b} are told; {self._before:b} are driven")
