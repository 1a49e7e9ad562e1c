"""One fault at a time in an otherwise undisturbed world, with what the executor must tell of it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from functools import partial
from random import Random
from typing import TYPE_CHECKING
from zlib import crc32

from hyperbit.controller.program import unpack
from tests.simulation.boot_faults import BootFaults
from tests.simulation.fault_kinds import FaultKinds
from tests.simulation.judge.arm import bits_of
from tests.simulation.judge.expected import judge_locks, told
from tests.simulation.judge.verdict import require
from tests.simulation.planner import ScriptedPlanner
from tests.simulation.single_fault import Fault
from tests.simulation.volleys import Volleys

if TYPE_CHECKING:
    from tests.simulation.judge.expected import Expected
    from tests.simulation.world import World

NOTHING = 0.8  # [s] for which it is watched that nothing is told
SUPERVISED = 0.6  # [s] until the last motion is supervised, and all outputs are read back after a pulse
ASKED = 0.2  # [s] beside the settle margin until an actuator at rest is supervised, and its board was asked
KEPT = 1.2  # [s] for which a fault must wait for its reset; faults that clear are tried once a second
LONG = 2.2  # [s] for which a fault may last, so that two attempts to leave it fail
ANSWERED = 0.1  # [s] until a reset is answered
HOMED = 0.7  # share of the faults before which a program homes the arm
VOLLEYS = 3  # of the kinds
RARE = {  # kinds that few arms permit
    *("door is opened", "wires are shorted", "actuator misses commands", "bus is down as a pulse begins"),
    *("another bus is down while a pulse ends", "another bus is stuck while a pulse ends"),
    *("nobody answers during a pulse", "a board loses the end of a pulse"),
    "a board is unplugged while it gets a pulse",
}
OF_BOARDS = {  # kinds that worlds with boards alone judge, too: they come last
    *("bus is down", "bus-off", "bus is unacknowledged", "queue is full", "bus-passive", "overruns", "overrun"),
    *("frames come twice", "answers are late", "emergency", "emergencies in a storm", "journal is not written"),
    *("foreign START", "foreign SYNC", "foreign heartbeat", "foreign RPDO", "short TPDO", "another program writes"),
    *("two boards have one node id", "error without an emergency", "outputs cannot be read", "TPDO is lost"),
    *("executor stalls for a moment", "another configuration", "a refused board"),
}
GOLDEN = 0.618034  # successive seeds begin at places that are evenly spread over the kinds
OWED = 4.2  # [s] for which lost answers may still come, and reads take so long that pulses may be over before
RESTARTED = 15.0  # [s] until an executor that was ended has contracted the arm, and the next one is ready


class SingleFaults:
    """Chooses single faults, and judges what the executor tells of them.

    All kinds that the arm permits come in turn. Each seed begins at another one, so that few seeds have all kinds.
    """

    def __init__(self, world: World, random: Random, seed: int) -> None:
        self._world, self._random, self._seed = world, random, seed
        self.kinds, self._boots = FaultKinds(world, random), BootFaults(world, random)
        self._volleys = Volleys(world, random)
        self._made: Counter[str] = Counter()
        told = world.account.arm
        self._rare = RARE | ({"executor ends with a lock"} if world.arm.contract_on_stop else set())
        self._rare |= {"executor is killed at a frame"} if told.paired & ~told.sensed else set()

    def happen(self) -> None:
        """Causes one fault, mends it, and brings the arm back.

        Raises:
            Violation: it is not told in time, or something else is told, or the arm does not become ready.
        """
        world, planner = self._world, self._world.planner
        assert isinstance(planner, ScriptedPlanner)
        planner.be_calm(True)
        planner.patient = True
        self._rest()
        if world.account.homing and self._random.random() < HOMED:
            self._home(planner)
        faults, others = self.kinds.possible(), self._others(planner)
        name = min([*faults, *others], key=self._turn)
        self._made[name] += 1
        world.note(f"only fault: {name}")
        if name in others:
            others[name]()
        else:
            world.disturb()
            world.trouble.made[f"only: {name}"] += 1
            self._judge(name, faults[name], planner)
            if any(not world.account.arm.sensed >> k & 1 for k in world.kinds.pulse):
                world.pass_time(OWED)
        planner.patient = False
        if not world.record.suspect and not world.account.clear:
            world.be_undisturbed()

    def _turn(self, name: str) -> tuple[int, float]:
        """Returns how often a kind came in this world, and its place among the kinds that came as often."""
        place = (crc32(name.encode()) / 2**32 + self._seed * GOLDEN) % 1.0
        return self._made[name], place / 3 if name in self._rare else place + (name in OF_BOARDS) / 2

    def _others(self, planner: ScriptedPlanner) -> dict[str, Callable[[], None]]:
        """Returns what ends a process, and what has no fault of its own."""
        made: dict[str, Callable[[], None]] = {
            "executor ends": partial(self._end_executor, planner, True, False),
            "executor ends with a lock": partial(self._end_executor, planner, True, True),
            "executor is killed": partial(self._end_executor, planner, False, False),
            "executor is killed at a frame": partial(self._end_executor, planner, False, True),
            "planner dies": partial(self._lose_planner, planner, True),
            "planner stands still": partial(self._lose_planner, planner, False),
            "interrupted": partial(self._interrupt, planner),
            "another configuration": partial(self._boots.happen, False),
            "a refused board": partial(self._boots.happen, True),
        }
        return made | {f"volley {k}": self._volleys.happen for k in range(VOLLEYS)}

    def _home(self, planner: ScriptedPlanner) -> None:
        """Homes all actuators of unknown state by a program that switches one actuator."""
        world = self._world
        free = bits_of(world.account.arm.everything & ~world.account.locked)
        if free:
            planner.ask_to_switch(self._random.choice(free))
            world.pass_time(ANSWERED)
            self._rest()

    def _rest(self) -> None:
        world = self._world
        world.wait(world.settled, "ready", world.ready_within)
        world.wait(lambda: not world.boards.coils() & world.kinds.pulsed, "without pulses", world.ready_within)
        world.wait(lambda: not unpack(world.planner.snapshot.unread), "read back", world.ready_within)
        world.pass_time(ASKED + max(world.kinds.margin))

    def _end_executor(self, planner: ScriptedPlanner, in_order: bool, special: bool) -> None:
        """Ends the executor, in order or by a kill; the judge goes on to judge each fact exactly.

        `special`: with a locked actuator, or at a frame.
        """
        world = self._world
        world.trouble.made["only: executor ends" if in_order else "only: executor is killed"] += 1
        if in_order and special:
            self._lock(planner)
        instance = world.executor.instances
        if not in_order and special:
            self._kill_at_rpdo(planner)
        elif self._random.random() < 0.7:
            planner.ask_for_motion()
            world.pass_time(self._random.choice([0.003, 0.02, 0.3, 1.0]))
        if in_order:
            world.executor.quit()
            drawn = self._random.random()
            if drawn < 0.25 and world.arm.contract_on_stop:  # somebody stops the arm in its contraction
                world.agenda.after(self._random.uniform(0.0, 0.3), planner.halt)
            elif drawn < 0.5:  # a second signal
                world.agenda.after(self._random.uniform(0.0, 0.3), world.executor.quit_again)
        elif world.executor.instances == instance:
            world.executor.kill()
        world.wait(lambda: world.executor.instances > instance, "started again", RESTARTED)
        planner.unlocks = True
        world.wait(world.settled, "ready", world.ready_within)

    def _kill_at_rpdo(self, planner: ScriptedPlanner) -> None:
        """Kills the executor when an RPDO is handed out, or later if none is.

        Mostly the RPDO is of an actuator of which the next process cannot know whether it has switched.
        """
        world, bus = self._world, self._random.choice(list(self._world.buses.values()))
        unseen = bits_of(world.account.arm.paired & ~world.account.arm.sensed & ~world.account.locked)
        if unseen and self._random.random() < 0.7:
            k = self._random.choice(unseen)
            bus = world.buses[world.arm.wiring.channels[k].bus]
            planner.ask_to_switch(k, times=6, pause=0.2)  # to and fro: it must be known before it contracts
            world.pass_time(self._random.uniform(0.1, 1.0))
        else:
            planner.ask_for_motion()
        bus.at_next_rpdo(lambda: world.agenda.after(0.0, world.executor.kill))
        world.pass_time(self._random.uniform(0.1, 0.4))
        bus.await_no_rpdo()

    def _lock(self, planner: ScriptedPlanner) -> None:
        """Locks an actuator where it is, if an end-stop tells its state; the executor that ends has it locked."""
        world = self._world
        free = world.account.arm.sensed & ~world.account.locked
        if free:
            extended = free & world.boards.positions()  # which `on_stop: contract` would contract
            k = self._random.choice(bits_of(extended if extended and self._random.random() < 0.7 else free))
            planner.ask_to_lock(k, world.boards.positions() >> k & 1)
            world.pass_time(ANSWERED)

    def _interrupt(self, planner: ScriptedPlanner) -> None:
        """Stops the arm, or cancels its program, when a SYNC or an RPDO is handed out."""
        world, bus = self._world, self._random.choice(list(self._world.buses.values()))
        planner.ask_for_motion()
        at_next = self._random.choice([bus.at_next_sync, bus.at_next_sync, bus.at_next_rpdo])
        dies = self._random.random() < 0.25

        def happen() -> None:
            planner.interrupt()
            if dies:
                planner.die()

        at_next(lambda: world.agenda.after(0.0, happen))
        world.trouble.made["only: interrupted"] += 1
        world.pass_time(self._random.uniform(0.3, 1.0))
        at_next(lambda: None)
        world.wait(world.settled, "ready", world.ready_within)

    def _lose_planner(self, planner: ScriptedPlanner, dies: bool) -> None:
        """Makes the planner die or stand still while a program may run; the judge still judges each fact exactly."""
        world, timeout = self._world, self._world.arm.planner_timeout
        if self._random.random() < 0.7:
            planner.ask_for_motion()
            world.pass_time(self._random.uniform(0.0, 0.3))
        world.trouble.made["only: planner dies" if dies else "only: planner stands still"] += 1
        if dies:
            planner.die()
            if self._random.random() < 0.5:  # the next one dies before it acknowledges anything
                world.wait(lambda: planner.snapshot is not None, "connected", 3.0 * timeout)
                planner.die()
            world.pass_time(self._random.uniform(0.0, 0.5))
        else:
            planner.stall(timeout * self._random.choice([0.7, 1.2, 1.2, 2.0]))
        world.wait(lambda: planner.awake, "awake", 3.0 * timeout)
        world.pass_time(0.3)
        world.wait(world.settled, "ready", world.ready_within)

    def _judge(self, name: str, fault: Fault, planner: ScriptedPlanner) -> None:
        world, expected = self._world, fault.expected
        asked = world.account.questions
        planner.unlocks = False
        held = fault.holds()
        fault.cause()
        if not expected.codes:
            self._watch(expected, NOTHING)
            require(not expected.asks or world.account.questions > asked, f"{name}, and the planner is not asked")
            planner.way = ""
            fault.mend()
            self._watch(expected, NOTHING / 5)
            self._require_mode("ready", name)
            planner.unlocks = True
            return
        world.wait(lambda: told(expected, planner.snapshot), f"told: {name}", expected.within)
        long = expected.cleared and self._random.random() < 0.2
        self._watch(expected, LONG if long else self._random.uniform(0.0, 0.3))
        if expected.refused:
            planner.ask_to_reset()
            world.wait(lambda: planner.last_answer is not None, "answered", ANSWERED)
            refused = planner.last_answer and planner.last_answer.refused
            right = refused and refused.reason.value == expected.refused
            require(right, f"a reset is answered by {planner.last_answer} while {name}")
        fault.mend()
        if not expected.cleared:
            self._watch(expected, KEPT if self._random.random() < 0.3 else ANSWERED)
            self._require_mode("fault", name)
            planner.patient = False
        world.wait(lambda: self._is("ready"), f"ready after {name}", world.ready_within)
        require(fault.holds() == held, f"{name} and the reset after it have changed {held} to {fault.holds()}")
        planner.patient = False
        self._watch(expected, SUPERVISED)  # an actuator that was released may move now
        world.wait(lambda: self._is("ready"), f"ready after {name}", world.ready_within)
        judge_locks(expected, planner.snapshot)
        planner.unlocks = True
        world.wait(world.settled, f"ready after {name}", world.ready_within)

    def _is(self, mode: str) -> bool:
        snapshot = self._world.planner.snapshot
        return snapshot is not None and snapshot.mode == mode

    def _require_mode(self, mode: str, name: str) -> None:
        snapshot = self._world.planner.snapshot
        shown = None if snapshot is None else (snapshot.mode, snapshot.reason, snapshot.faults)
        require(snapshot is not None and snapshot.mode == mode, f"{name} ends in {shown}, not {mode}")

    def _watch(self, expected: Expected, seconds: float) -> None:
        until = self._world.agenda.now + seconds
        while self._world.agenda.now < until:
            self._world.one_step()
            told(expected, self._world.planner.snapshot)
