"""Single faults of boards and buses that run, and what the master must tell of each."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from tests.simulation.fieldbus.bus_faults import BusFaults
from tests.simulation.fieldbus.command_faults import CommandFaults
from tests.simulation.fieldbus.expected import Expected, Fault
from tests.simulation.fieldbus.object_faults import ObjectFaults
from tests.simulation.fieldbus.supervision_faults import SupervisionFaults
from tests.simulation.fieldbus.unsent_faults import UnsentFaults
from tests.simulation.judge.verdict import Violation, require

if TYPE_CHECKING:
    from tests.simulation.fieldbus.world import BoardWorld

KEPT = 0.25  # [s] for which nothing else may be told
PROBES = 0.5  # [s] between two questions to lost boards
BACK = 3.0  # [s] until a mended board is heard


MAKERS = SupervisionFaults, BusFaults, ObjectFaults, CommandFaults, UnsentFaults


class Faults:
    def __init__(self, world: BoardWorld) -> None:
        self._world = world

    def happen(self) -> None:
        """Causes one fault, judges what is told, mends it, and boots the boards again."""
        world = self._world
        for _ in range(20):
            makers = world.random.choice(MAKERS).of(world)
            name, make = world.random.choice(list(makers.items()))
            fault = make()
            if fault is not None:
                break
        else:
            return
        world.made[f"fault: {name}"] += 1
        world.note(f"fault: {name}")
        self._judge(name, fault)

    def _judge(self, name: str, fault: Fault) -> None:
        world, expected = self._world, fault.expected
        master = world.master
        world.ready, world.calm = False, expected.calm
        began = world.agenda.now
        fault.cause()
        told: list[Any] = []

        def heard() -> bool:
            for one in master.drain_faults():
                told.append(one)
                ours = one.code in expected.codes
                require(ours or one.code in expected.also, f"{name}: {one} is told; {expected} has a cause")
                if ours and one.code not in expected.also:
                    right = one.source == expected.source and all(word in one.message for word in expected.words)
                    require(right, f"{name}: {one} is told; {expected} has a cause")
                    after = world.agenda.now - began
                    require(after >= expected.least, f"{name} is told after {after:g} s")
            return any(one.code in expected.codes for one in told)

        if expected.codes:
            world.wait(heard, expected.within, f"told: {name}, {expected}")
        else:
            world.pass_time(expected.within)
            heard()
        self._judge_known(name, expected)
        fault.check()
        until = world.agenda.now + KEPT
        while world.agenda.now < until:
            world.pass_time(0.05)
            heard()
        pairs = [(one.code, one.source) for one in told]
        require(len(set(pairs)) == len(pairs), f"{name}: {told} has a fault twice")
        fault.mend()
        world.site.boards.see("foreign")
        world.calm = True
        world.watching.restart(world.agenda.now)
        self._come_back(name, expected)

    def _judge_known(self, name: str, expected: Expected) -> None:
        world = self._world
        master, boards = world.master, world.wiring.boards
        if expected.also:
            return
        require(
            master.outputs_known == (not expected.lost),
            f"{name}: outputs_known is {master.outputs_known}, lost are {expected.lost}",
        )
        inputs = actuators = 0
        for board in boards.values():
            if board.name in expected.lost:
                actuators |= board.actuators
            else:
                inputs |= board.input_lines
        known = world.wiring.actuators & ~actuators
        require(master.known == known, f"{name}: {master.known:b} are known, {known:b} have all boards")
        require(master.inputs_known == inputs, f"{name}: inputs {master.inputs_known:b} are known, {inputs:b} are")
        require(not master.ends & ~inputs, f"{name}: inputs {master.ends:b} are told, {inputs:b} are known")

    def _come_back(self, name: str, expected: Expected) -> None:
        world = self._world
        master = world.master
        until = world.agenda.now + BACK
        while not master.back:
            if world.agenda.now > until:
                raise Violation(f"{name}: nothing is back {BACK:g} s after its end")
            world.site.call(lambda m: m.probe_silent(world.agenda.now))
            world.pass_time(PROBES)
        still = not expected.codes and not expected.lost
        if still and expected.calm:
            master.drain_switched()
            world.ready = True
            world.watching.ready(world.agenda.now)
            world.settle()
            require(not master.drain_faults(), f"{name} is told later")
            return
        for bus in world.site.buses.values():
            bus.drop()
        silent = 0.0 if expected.calm else 1.3 * world.drawn.timing.heartbeat_timeout + world.drawn.timing.heartbeat
        world.pass_time(0.03 + silent)  # boards that have lost the master notice it before the boot
        master.drain_faults()
        master.drain_switched()
        if world.random.random() < 0.3:
            world.site.master, world.calm = None, False
            world.change()
            world.pass_time(1.3 * world.drawn.timing.heartbeat_timeout)  # a board may wait less for heartbeats now
        world.boot(new=world.random.random() < 0.3)
