"""Feeds the judge of what clients see with what the executor takes and tells, and with the mechanics of the arm."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from hyperbit.controller.arm.arm import Arm
from hyperbit.controller.executor.arm.arm import ExecutedArm
from hyperbit.controller.executor.core.events import Event, FromClient
from hyperbit.controller.host.process import Quit
from hyperbit.controller.program import Hello, Stop, Up
from tests.simulation.agenda import Agenda
from tests.simulation.executor.process import Witness
from tests.simulation.judge.interface.interface import InterfaceJudge
from tests.simulation.judge.interface.modules import JudgedModules, ModuleFacts
from tests.simulation.judge.judge import Judge
from tests.simulation.record import Record

if TYPE_CHECKING:
    from tests.simulation.whole.daemon import Daemon

SILENCE_NOTICED = 0.5  # [s] beyond twice the planner's time-out, after which a silent executor is told


def interface_judge(
    judge: Judge, executed: ExecutedArm, arm: Arm, record: Record
) -> Callable[[Daemon], InterfaceJudge]:
    """Returns a function that makes the judge of a daemon's clients."""
    manipulator = arm.manipulator
    facts = [ModuleFacts(module.frames, module.bits) for module in manipulator.modules]
    most = len(executed.actuators) if executed.inrush is None else executed.inrush
    account = judge.account

    def make(daemon: Daemon) -> InterfaceJudge:
        modules = JudgedModules(facts, manipulator.base, executed.actuators, daemon.weights, most)
        made = InterfaceJudge(modules, daemon.wall, lambda: judge.ground.states, lambda: account.clear)
        of = made.account
        of.tolerance, of.angle_tolerance, of.length = arm.tolerance, arm.angle_tolerance, modules.farthest
        longest = max(max(travel) for travel in judge.arm.travel) + max(judge.arm.margin) + executed.rest
        of.longest_transition = 2 * len(executed.actuators) * (longest + 0.1)
        of.lead, of.travel, of.rest = daemon.pace.lead, arm.travel_time, executed.rest
        of.inrush = executed.inrush is not None
        of.declared = bytes(
            (executed.locked_states >> k & 1) if executed.locked >> k & 1 else 255
            for k in range(len(executed.actuators))
        )
        if (tracker := arm.settings.tracker) is not None:
            of.bias, of.offset, of.clamp, of.hold = (0.0, 0.0), daemon.offset, tracker.clamp, tracker.hold
        made.link.timeout = executed.planner_timeout
        made.searches.prepares = arm.settings.method == "minimum-switch"
        of.silent_after = 2.0 * executed.planner_timeout + SILENCE_NOTICED

        def sure() -> bool:
            """Returns whether nobody doubts the states of the actuators; outputs in pairs may be adopted otherwise."""
            if account.clear:
                return True
            snapshot = of.snapshot
            known = snapshot is not None and (snapshot.moving or snapshot.measured == snapshot.outputs)
            ending = of.had("executor quits", of.now - 15.0)
            doubtful = record.suspect or record.fallen or record.lying or judge.arm.paired
            return known and not doubtful and not ending

        of.sure = sure
        of.interlock_open = record.open_lately
        judge.programs.count = made.switches
        return made

    return make


class InterfaceFeed(Witness):
    """Translates what the executor takes and tells into facts for the judge of what clients see."""

    def __init__(self, judge: InterfaceJudge, agenda: Agenda) -> None:
        self._judge, self._agenda, self._instances = judge, agenda, 0
        self._operators: set[int] = set()

    def started(self) -> None:
        self._instances += 1
        self._judge.at(self._agenda.now)
        self._judge.executor_begins(self._instances)

    def killed(self) -> None:
        self._judge.at(self._agenda.now)
        self._judge.executor_ends()

    def told(self, event: Event) -> None:
        match event:
            case FromClient(client, Hello() as hello):
                if hello.role != "planner":
                    self._operators.add(client.number)
            case FromClient(client, message):
                self._judge.at(self._agenda.now)
                if isinstance(message, Stop) and client.number in self._operators:
                    self._judge.account.note("halted")
                self._judge.executor_gets(message)
            case Quit():
                self._judge.account.note("executor quits", self._agenda.now)
            case _:
                pass

    def says(self, message: Up) -> None:
        self._judge.at(self._agenda.now)
        self._judge.executor_tells(message)
