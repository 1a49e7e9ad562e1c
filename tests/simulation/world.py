"""The world of an executor: clock, buses, boards, clients, and faults of all of them, drawn from one seed."""

from __future__ import annotations

import math
from collections import Counter, deque
from collections.abc import Callable
from random import Random

from hyperbit.controller.executor.arm.kinds import Kinds
from hyperbit.controller.program import unpack
from hyperbit.drivers.canopen.wire.cia301 import Frame
from tests.simulation.agenda import Agenda, StepsAreOver
from tests.simulation.buses.board_side import BoardSide
from tests.simulation.buses.bus_model import BusModel, OnItsWay
from tests.simulation.calm import check_daemon, one_fault, run_a_goal, run_a_program, work
from tests.simulation.executor.arm_file import judge_file
from tests.simulation.executor.arms import draw_arm, draw_boards
from tests.simulation.executor.process import ExecutorProcess, Habits
from tests.simulation.executor.strangers import Strangers
from tests.simulation.faults.processes import STILL
from tests.simulation.faults.sight import Sight
from tests.simulation.faults.trouble import Trouble
from tests.simulation.planner import ScriptedPlanner
from tests.simulation.record import Record
from tests.simulation.single_faults import SHOWN, SingleFaults
from tests.simulation.statements.account import Account
from tests.simulation.statements.every import of_clients, of_the_executor
from tests.simulation.statements.objects import BoardObjects
from tests.simulation.statements.statement import Witnesses
from tests.simulation.struck import StruckWorld
from tests.simulation.verdict import Violation, require
from tests.simulation.whole.daemon import Daemon
from tests.simulation.whole.planned_arms import draw_planned_arm

ROUNDS = ("one fault",) * 5 + ("requests",) * 3 + ("commission", "end", "trouble")  # of worlds with a scripted planner
WHOLE_TROUBLED = 0.9  # share of the rounds of a whole daemon that have a time with many faults
PEACEFUL = 0.3  # share of the worlds with the whole daemon that have no trouble
WORK, PEACEFUL_WORK = 0.4, 0.9  # share of the rounds of a whole daemon in which clients wait for each goal's end
FILES = 0.9  # share of the arms that are written to a file and read
PATIENCE = 15.0  # [s] added to the boot time until the arm is ready after all trouble; late SDO answers take long


ECHO_LOST = 0.05  # [s] after which the executor knows that an echo was lost


class World(StruckWorld):
    """One arm, its executor, its boards and its clients.

    Attributes:
        let_go: mask of the actuators with two outputs that their boards contract without the executor.

    Args:
        whole: whether the planner's core, its shell and clients are in the world; False: a scripted planner.
        only: name of the one fault that strikes, alone, in a world with a scripted planner; "": all of the table.
    """

    def __init__(self, seed: int, whole: bool = False, remembered: int = 300, only: str = "") -> None:
        def drawn(what: str) -> Random:
            return Random(f"{seed} {what}")

        random, planned = drawn("arm"), None
        arm = draw_arm(random, whole)
        while whole and not 4 <= len(arm.actuators) <= 9:
            arm = draw_arm(random, whole)
        if whole:
            arm, planned = draw_planned_arm(drawn("modules"), arm)
        arm, variants = draw_boards(drawn("boards"), arm)
        if not whole and random.random() < FILES:
            judge_file(arm, random)
        self.arm = arm
        self.most = len(arm.actuators) if arm.inrush is None else arm.inrush
        self.agenda = agenda = Agenda()
        self.events: deque[tuple[float, object]] = deque(maxlen=remembered)
        self.buses = {
            bus.name: BusModel(bus.name, bus.bitrate, agenda, drawn(bus.name), self._to_boards, self.tell)
            for bus in arm.wiring.buses
        }
        self.account = Account(self)
        self.record, every = Record(self.account), of_the_executor(self.account)
        self.objects = next(one for one in every if isinstance(one, BoardObjects))
        witness = Witnesses(self.account)
        self.habits = habits = Habits(drawn("habits"))
        self.executor = ExecutorProcess(arm, agenda, drawn("executor"), self.buses, witness, habits)
        self.kinds = Kinds(arm.wiring, arm.timing)
        self.planner: ScriptedPlanner | Daemon
        self.strangers: Strangers | None = None
        self.daemon: Daemon | None = None
        if planned is None:
            self.planner = ScriptedPlanner(arm, agenda, drawn("planner"), self.executor)
            count = len(arm.actuators)
            parts = arm.name, count, agenda, drawn("strangers"), self.executor
            self.strangers = Strangers(*parts, lambda: self.account.planner is not None)
        else:
            simulated = habits.simulation is not None
            judged = self.account.arm
            habits.forgets = not (judged.paired | judged.forgone) & ~judged.sensed  # else the journal alone knows
            self.planner = self.daemon = Daemon(
                arm, planned, agenda, drawn, self.executor, self.note, simulated, self.account
            )
            witness.add(self.daemon.exchange)
            every += of_clients(self.daemon.exchange, arm, planned, self.daemon.space)
        self.account.judge([self.record, *every])
        cut_off = self.planner.cut_off if isinstance(self.planner, ScriptedPlanner) else self.planner.network.cut_off
        self.executor.connect(self.planner.connection.deliver, cut_off)
        self.boards = BoardSide(arm.wiring, arm.timing, variants, agenda, self._from_board, self.account)
        levels = arm.wiring.loss_levels[len(arm.actuators) :]
        self.let_go = sum(1 << k for k, level in zip(arm.wiring.paired, levels, strict=True) if level == 1)
        self.wiring, self.timing = arm.wiring, arm.timing
        self.sight = Sight(arm.wiring, arm.timing, self.boards, variants)
        self.trouble = Trouble(self, drawn("trouble"), seed)
        self.single_faults = SingleFaults(self, drawn("single faults"), seed, only)
        self._ends = SingleFaults(self, drawn("ends"), seed, "executor ends")
        self._rounds = ("one fault",) if only else ROUNDS
        self._random = drawn("periods")
        self._peaceful = whole and drawn("peace").random() < PEACEFUL
        self.executor.start()

    def run(self, steps: int) -> None:
        """Runs `steps` steps: the arm becomes ready, then come rounds of requests, faults and trouble."""
        self.agenda.end = self.agenda.steps + steps
        try:
            self.calm()
            while True:
                if self.daemon is None:
                    self._scripted_round(self._random.choice(self._rounds))
                else:
                    self._whole_round(self.daemon)
        except StepsAreOver:
            self.agenda.end = math.inf

    def _scripted_round(self, kind: str) -> None:
        alone = {"one fault": self.single_faults, "end": self._ends}.get(kind)
        self._let_strangers_stop(alone is None)
        if alone is not None:
            alone.happen()
            return
        self.planner.be_calm(False)
        if kind == "commission" and isinstance(self.planner, ScriptedPlanner):
            self.planner.commission(True)
            self.pass_time(self._random.uniform(2.0, 6.0))
        elif kind == "requests":
            self.pass_time(self._random.uniform(0.5, 2.5))
        else:
            self._trouble(6.0)

    def _whole_round(self, daemon: Daemon) -> None:
        """Lets clients ask, and the planner die at one of their goals; trouble follows. In peace there is neither."""
        if self._random.random() < (PEACEFUL_WORK if self._peaceful else WORK):
            work(self, daemon, self._peaceful)
            return
        self.planner.be_calm(False)
        if not self._peaceful:
            self.disturb()
            daemon.die()
        self.pass_time(self._random.uniform(0.5, 3.0))
        if self._peaceful:
            self.calm()
        elif self._random.random() < WHOLE_TROUBLED:
            self._trouble(4.0)

    def _trouble(self, longest: float) -> None:
        self.disturb()
        self.trouble.begin()
        self.pass_time(self._random.uniform(2.0, longest))
        self.calm()

    def pass_time(self, seconds: float) -> None:
        until = self.agenda.now + seconds
        while self.agenda.now < until:
            self.one_step()

    def one_step(self) -> None:
        """Runs the next event, and judges it."""
        self.agenda.step()
        self.account.see("steps")

    def _let_strangers_stop(self, may: bool) -> None:
        if self.strangers is not None:
            self.strangers.may_stop = may

    def calm(self) -> None:
        """Ends all trouble; the arm becomes ready, runs a program, and everything agrees."""
        self._let_strangers_stop(False)
        self.trouble.end()
        self.planner.be_calm(True)
        self.wait(lambda: self.executor.awake and self.planner.awake, "awake", STILL + 2.0)
        if self.daemon is None:
            run_a_program(self)
        else:
            run_a_goal(self, self.daemon)
        self.wait(self.settled, "ready", self.ready_within)
        self.pass_time(SHOWN)  # a SYNC may be on the bus as a program is canceled
        self.wait(self.settled, "ready", self.ready_within)
        self._check_agreement()
        if self.daemon is not None:
            check_daemon(self, self.daemon)
            if self.drawn_half():
                self.disturb()
                one_fault(self, self.daemon, self._random)
                self.wait(self.settled, "ready after one fault", self.ready_within)
        for name in self.boards.simulated.names:
            self.objects.judge(name)
        if not self.record.suspect:
            self.be_undisturbed()

    def disturb(self) -> None:
        self.account.disturbed()

    def be_undisturbed(self) -> None:
        self.account.see("rests")

    @property
    def ready_within(self) -> float:
        """Longest time until the arm is ready after all trouble [s]."""
        return self.arm.timing.boot_timeout + PATIENCE

    def wait(self, holds: Callable[[], bool], text: str, patience: float) -> None:
        """Runs steps until something holds."""
        until = self.agenda.now + patience
        while not holds():
            snapshot = self.planner.snapshot
            shown = snapshot and (snapshot.mode, snapshot.reason, snapshot.faults)
            require(self.agenda.now < until, f"it is not {text} after {patience:g} s: {shown}")
            self.one_step()

    def settled(self) -> bool:
        """Whether the arm is at rest, and takes programs."""
        snapshot = self.planner.snapshot
        if snapshot is None or snapshot.mode != "ready" or snapshot.moving or not self.executor.awake:
            return False
        return not unpack(snapshot.locked) & ~self.arm.locked

    def _check_agreement(self) -> None:
        """Compares the last snapshot, the boards, the journal and the results."""
        snapshot, record = self.planner.snapshot, self.record
        assert snapshot is not None
        drives, outputs = self.boards.drives(), unpack(snapshot.outputs)
        agree = (drives ^ outputs) & ~record.suspect & ~unpack(snapshot.homing) == 0
        require(agree, f"the boards drive {drives:b}, the executor says {outputs:b}")
        positions, measured = self.boards.positions(), unpack(snapshot.measured)
        told = unpack(snapshot.sensed) & unpack(snapshot.known)
        require((positions ^ measured) & told == 0, f"the actuators are at {positions:b}, measured is {measured:b}")
        accepted = {key for key in record.programs if key[0] == record.instance}
        without = sorted(number for key in accepted - set(record.results) for number in key[1:])
        require(not without, f"programs {without} have no result")
        require(self.intended == 0, "the journal waits for nothing")

    def drawn_half(self) -> bool:
        return self._random.random() < 0.5

    def drawn(self, most: int) -> int:
        return self._random.randint(0, most)

    def share(self) -> float:
        return self._random.random()

    def _to_boards(self, bus: str, sent: OnItsWay, lost: bool) -> None:
        self.boards.hear(bus, sent, lost)

    def _from_board(self, bus: str, frame: Frame) -> None:
        self.account.see("answers", bus, frame)
        self.buses[bus].from_board(frame)

    def mend(self) -> None:
        """Ends all faults at once; stalls continue to their end."""
        for bus in self.buses.values():
            bus.restore()
        self.boards.mend()
        self.executor.recover()
        if self.daemon is not None:
            self.daemon.mend()

    def reaches(self, actuator: int) -> bool:
        """Returns whether frames of the executor reach the board of an actuator, and take effect there."""
        channel = self.arm.wiring.channels[actuator]
        bus = self.buses[channel.bus]
        fit = self.executor.awake and bus.healthy and not bus.loss
        told = self.agenda.now > bus.echo_lost_at + ECHO_LOST and not bus.echo_owed
        return fit and told and self.boards.takes_part(f"{channel.bus}/{channel.node}")

    @property
    def intended(self) -> int:
        """Mask of the intended switches that the journal has not counted yet."""
        return self.executor.journal._intended

    def note(self, event: object) -> None:
        self.events.append((self.agenda.now, event))

    def counts(self) -> Counter[str]:
        counts = self.record.counts + self.trouble.made
        counts += Counter({f"sent {word}": count for word, count in self.planner.connection.sent.items()})
        counts += self.account.statements.counts()
        return counts if self.daemon is None else counts + self.daemon.counts

    def story(self) -> str:
        return "\n".join(f"{time - 1000:.6f} {event}" for time, event in self.events)


__all__ = ["Violation", "World"]
