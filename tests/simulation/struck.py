"""What faults need of a world with an executor."""

from __future__ import annotations

from random import Random
from typing import TYPE_CHECKING

from hyperbit.controller.executor.arm.arm import ExecutedArm
from hyperbit.controller.executor.arm.kinds import Kinds
from hyperbit.controller.executor.core.events import Event
from hyperbit.drivers.canopen.wire import cia301
from hyperbit.drivers.canopen.wire.cia301 import Command, Frame, State
from tests.simulation.buses.board_side import BoardSide
from tests.simulation.executor.process import ExecutorProcess
from tests.simulation.faults.fault import Fault, Switch, Told
from tests.simulation.faults.motion import ASKED
from tests.simulation.faults.sight import Sight
from tests.simulation.planner import ScriptedPlanner
from tests.simulation.statements.account import Account
from tests.simulation.statements.objects import BoardObjects
from tests.simulation.whole.daemon import Daemon

if TYPE_CHECKING:
    from hyperbit.drivers.canopen.wiring import Wiring


class StruckWorld:
    """The part of a world that faults strike.

    Attributes:
        kinds: outputs and end-stops of the actuators.
        planner: the scripted planner, or the daemon.
        daemon: the whole daemon but its executor; None in a world with a scripted planner.
    """

    arm: ExecutedArm
    wiring: Wiring
    kinds: Kinds
    boards: BoardSide
    executor: ExecutorProcess
    planner: ScriptedPlanner | Daemon
    daemon: Daemon | None
    account: Account
    objects: BoardObjects
    sight: Sight
    _random: Random

    def settled(self) -> bool:
        """Whether the arm is at rest, and takes programs."""
        raise NotImplementedError

    def tell(self, event: Event) -> None:
        self.executor.post(event)

    def order(self, name: str, command: int) -> None:
        """Another program commands a board, unheard by the executor."""
        bus, node = name.split("/")
        self.boards.hear_tool(bus, Frame(cia301.NMT, bytes([command, int(node)])))

    def let_be_found(self, name: str) -> None:
        """Takes a board out of state stopped that does not tell this state: it answers no SDO."""
        board = self.boards.simulated.board(name)
        if board.state is State.STOPPED and not board.objects.has(0x100C) and not board.objects.number(0x1017):
            self.order(name, Command.PRE_OPERATIONAL)

    def stall(self, seconds: float) -> None:
        self.executor.stall(seconds)

    def kill(self, dead: float) -> None:
        self.executor.kill()

    def moves(self) -> bool:
        """Whether the arm may be switched, boots, or is otherwise not at rest."""
        return not self.settled()

    def ignored(self, bus: str) -> int:
        return 0  # only worlds of boards judge it

    def may_switch(self, k: int) -> bool:
        """Whether an actuator can be switched by a program of the scripted planner."""
        scripted = isinstance(self.planner, ScriptedPlanner) and self.planner.snapshot is not None
        return scripted and not (self.account.locked >> k & 1 or self.account.homing)

    def ask_again(self, k: int) -> None:
        if self.may_switch(k):
            self.planner.ask_to_switch(k)

    def ask_to_reset(self) -> None:
        """Asks for a reset, as an operator does who does not see that a door is open."""
        if self.daemon is not None:
            self.daemon.clients.ask("reset")
        elif self.planner.snapshot is not None and self.planner.connection.client is not None:
            self.planner.ask_to_reset()

    def switch_on(self, name: str) -> Switch | None:
        """Returns a command that switches an output of a board that is read back, without a pulse."""
        channels, arm = self.wiring.channels, self.account.arm
        here = [k for k, c in enumerate(channels) if f"{c.bus}/{c.node}" == name and c.pulse is None]
        fit = [k for k in here if self.may_switch(k) and not arm.forgone >> k & 1]
        if not fit or any(not node.verify for node in self.wiring.nodes if f"{node.bus}/{node.node}" == name):
            return None
        k = self._random.choice(fit)
        late = max(self.kinds.travel[k]) + self.kinds.margin[k] + self.arm.rest + ASKED
        also = ("stuck", "unexpected-motion") if arm.sensed >> k & 1 else ()
        place = self.sight.wiring.boards[name].base, channels[k].output // 8 + 1
        return Switch(lambda: self.planner.ask_to_switch(k), place, late, channels[k].actuator, also)

    def flip_of(self, name: str) -> Fault | None:
        """Returns a motion of an actuator whose end-stop is on a board."""
        channels, arm, boards = self.wiring.channels, self.account.arm, self.boards
        here = [k for k, c in enumerate(channels) if f"{c.bus}/{c.node}" == name and arm.sensed >> k & 1]
        if not here:
            return None
        k = self._random.choice(here)
        label, end = channels[k].actuator, 1 - (boards.positions() >> k & 1)
        travel = self.kinds.travel[k][end]
        told = Told(("unexpected-motion",), (label,), (), travel + ASKED, least=travel)
        return Fault(lambda: boards.fault("stick", label, end), lambda: boards.fault("release", label), told)

    def reads_outputs(self, name: str) -> bool:
        return False  # the journal would count what another program has written
