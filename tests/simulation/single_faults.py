"""One fault of the table at a time in an otherwise undisturbed world, with what the executor must tell of it."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from random import Random
from typing import TYPE_CHECKING, Any

from hyperbit.controller.program import unpack
from tests.simulation.faults.fault import Deck, Fault, Row, Told
from tests.simulation.faults.table import rows
from tests.simulation.planner import ScriptedPlanner
from tests.simulation.statements.arm import bits_of
from tests.simulation.statements.objects import Values
from tests.simulation.verdict import require

if TYPE_CHECKING:
    from tests.simulation.world import World

SHOWN = 0.1  # [s] until a snapshot tells
SUPERVISED = 0.6  # [s] until the last motion is supervised, and all outputs are read back after a pulse
ASKED = 0.2  # [s] beside the settle margin until an actuator at rest is supervised, and its board was asked
KEPT = 1.2  # [s] for which a fault must wait for its reset; faults that clear are tried once a second
LONG = 2.2  # [s] for which a fault may last, so that two attempts to leave it fail
ANSWERED = 0.1  # [s] until a reset is answered
HOMED = 0.7  # share of the faults before which a program homes the arm
OWED = 4.2  # [s] for which lost answers may still come, and reads take so long that pulses may be over before
RESTARTED = 15.0  # [s] until an executor that was ended has contracted the arm, and the next one is ready
STANDING = frozenset({"board-limits", "outputs-off", "degraded", "unknown-position", "not-commissioned"})
WARNINGS = STANDING | {"bus-passive", "journal"}


class SingleFaults:
    """Draws single faults, each as often as the others, and judges what the executor tells of them."""

    def __init__(self, world: World, random: Random, seed: int, only: str = "") -> None:
        self._world, self._random = world, random
        drills: dict[str, Callable[[], None]] = {
            "executor ends": partial(self._end_executor, True, False),
            "executor ends with a lock": partial(self._end_executor, True, True),
            "executor is killed": partial(self._end_executor, False, False),
            "executor is killed at a frame": partial(self._end_executor, False, True),
            "planner dies": partial(self._lose_planner, True),
            "planner stands still": partial(self._lose_planner, False),
            "interrupted": self._interrupt,
        }
        judged = rows("bus", "board", "executor", "actuator", "process", "left")
        judged += [Row(name, partial(_drill, drill), "drill", False, 0.0) for name, drill in drills.items()]
        self.names = [row.name for row in judged]
        self._deck = Deck([row for row in judged if only in ("", row.name)], random, seed)

    @property
    def planner(self) -> ScriptedPlanner:
        assert isinstance(self._world.planner, ScriptedPlanner)
        return self._world.planner

    def happen(self) -> None:
        """Causes one fault, ends it, and brings the arm back.

        Raises:
            Violation: it is not told in time, or something else is told, or the arm does not become ready.
        """
        world, planner = self._world, self.planner
        planner.be_calm(True)
        planner.patient = True
        self._rest()
        if world.account.homing and self._random.random() < HOMED:
            self._home()
        drawn = self._deck.draw(world, alone=True)
        if drawn is None:  # the one fault cannot strike now
            world.pass_time(KEPT)
            return
        one, fault = drawn
        world.trouble.made[f"only: {one.name}"] += 1
        world.note(f"only fault: {one.name}")
        if one.strikes == "drill":
            fault.begin()
        elif one.strikes == "left":
            world.disturb()
            self._boot_with(one.name, fault)
        else:
            world.disturb()
            self._judge(one.name, fault)
            if any(not world.account.arm.sensed >> k & 1 for k in world.kinds.pulse):
                world.pass_time(OWED)
        planner.patient = False
        if not world.record.suspect and not world.account.clear:
            world.be_undisturbed()

    def _home(self) -> None:
        """Homes all actuators of unknown state by a program that switches one actuator."""
        world = self._world
        free = bits_of(world.account.arm.everything & ~world.account.locked)
        if free:
            self.planner.ask_to_switch(self._random.choice(free))
            world.pass_time(ANSWERED)
            self._rest()

    def _rest(self) -> None:
        world = self._world
        world.wait(world.settled, "ready", world.ready_within)
        world.wait(lambda: not world.boards.coils() & world.kinds.pulsed, "without pulses", world.ready_within)
        world.wait(lambda: not unpack(self._snapshot.unread), "read back", world.ready_within)
        world.pass_time(ASKED + max(world.kinds.margin))

    # --- what is told

    def _judge(self, name: str, fault: Fault) -> None:
        world, planner, told = self._world, self.planner, fault.told
        assert told is not None
        questions, held = world.account.questions, fault.holds()
        planner.unlocks = False
        fault.begin()
        if not told.codes:
            self._watch(name, told, told.within)
            asked = world.account.questions > questions
            require(not told.asks or asked, f"{name}, and the planner is not asked")
            planner.way = ""
            fault.end()
            self._watch(name, told, SHOWN)
            if not told.lost:
                self._come_back(name)
            planner.unlocks = True
            return
        world.wait(lambda: self._tells(name, told), f"told: {name}", told.within + SHOWN)
        long = told.clears and self._random.random() < 0.2
        self._watch(name, told, LONG if long else self._random.uniform(0.0, 0.3))
        if told.refused:
            planner.ask_to_reset()
            world.wait(lambda: planner.last_answer is not None, "answered", ANSWERED)
            refused = planner.last_answer and planner.last_answer.refused
            right = refused and refused.reason.value == told.refused
            require(right, f"a reset is answered by {planner.last_answer} while {name}")
        fault.end()
        if not told.clears:
            self._watch(name, told, KEPT if self._random.random() < 0.3 else ANSWERED)
            self._require_mode("fault", name)
            planner.patient = False
        self._come_back(name)
        require(fault.holds() == held, f"{name} and the reset after it have changed {held} to {fault.holds()}")
        planner.patient = False
        self._watch(name, told, SUPERVISED)  # an actuator that was released may move now
        self._come_back(name)
        if told.locks is not None:
            label, locked = told.locks
            degraded = any((one.code, one.source) == ("degraded", label) for one in self._snapshot.faults)
            require(degraded == locked, f"{label} is told as locked: {degraded}; the arm continues on stuck: {locked}")
        planner.unlocks = True
        world.wait(world.settled, f"ready after {name}", world.ready_within)

    def _come_back(self, name: str) -> None:
        self._world.wait(lambda: self._is("ready"), f"ready after {name}", self._world.ready_within)

    @property
    def _snapshot(self) -> Any:
        return self.planner.snapshot

    def _is(self, mode: str) -> bool:
        return self._snapshot is not None and self._snapshot.mode == mode

    def _require_mode(self, mode: str, name: str) -> None:
        shown = self._snapshot and (self._snapshot.mode, self._snapshot.reason, self._snapshot.faults)
        require(self._is(mode), f"{name} ends in {shown}, not {mode}")

    def _watch(self, name: str, told: Told, seconds: float) -> None:
        until = self._world.agenda.now + seconds
        while self._world.agenda.now < until:
            self._world.one_step()
            self._tells(name, told)

    def _tells(self, name: str, told: Told) -> bool:
        """Returns whether the snapshot tells a fault, and requires that it tells nothing else."""
        snapshot, found = self._snapshot, False
        if snapshot is None:
            return False
        also = (*told.also, *(("interlock", "board-lost", "stuck") if told.lost else ()))
        for fault in snapshot.faults:
            if fault.code in STANDING:
                continue
            ours = fault.code in told.codes
            require(ours or fault.code in also, f"{name}: {fault} is told; {told} has a cause")
            if ours:
                named = any(fault.source == one or fault.source.startswith(f"{one} (") for one in told.sources)
                right = not told.sources or named
                require(right or fault.code in also, f"{name}: {fault} is told; {told} has a cause")
                worded = not right or fault.code in also or all(word in fault.message for word in told.words)
                require(worded, f"{name}: {fault} is told; {told} has a cause")
                found |= right
        stops = any(fault.code not in WARNINGS for fault in snapshot.faults)
        modes = ("fault", "starting", "stopped") if stops else ("ready", "executing", "starting", "stopped")
        require(snapshot.mode in modes, f"{name}: mode {snapshot.mode} with {snapshot.faults}")
        return found

    # --- boots after something was left on a board

    def _boot_with(self, name: str, fault: Fault) -> None:
        """Kills the executor, leaves something on a board, and judges the next boot."""
        world, told, planner = self._world, fault.told, self.planner
        assert told is not None
        instance, found = world.executor.instances, dict[str, Values]()

        def begin() -> None:
            fault.begin()
            world.boards.see("fault")
            found.update({board: world.sight.found(board).values for board in world.boards.names})

        world.executor.at_next_start(begin)
        world.executor.kill()
        world.wait(lambda: world.executor.instances > instance, "started again", RESTARTED)
        if told.codes:
            wanted = f"in mode fault: {name}, {told}"
            world.wait(lambda: self._is("fault"), wanted, RESTARTED)
            ours = [one for one in self._snapshot.faults if one.source in told.sources]
            right = len(ours) == 1 and ours[0].code in told.codes and all(w in ours[0].message for w in told.words)
            require(right, f"{name}: told is {self._snapshot.faults}; {told} has a cause")
            here = [one for one in self._snapshot.faults if one.source.split("/")[0] in world.buses]
            others = [one for one in here if one.source not in told.sources and one.code not in WARNINGS]
            require(not others, f"only {told.sources} has a cause for a fault, told is {others}")
        fault.end()
        for board in world.boards.simulated.names:
            world.let_be_found(board)
        planner.patient = told.clears or not told.codes
        world.wait(world.settled, f"ready after {name}", world.ready_within)
        for board, values in found.items():
            world.objects.judge(board)
            if not told.codes:
                world.objects.judge_kept(board, values, world.sight.found(board).values)

    # --- drills

    def _end_executor(self, in_order: bool, special: bool) -> None:
        """Ends the executor, in order or by a kill; each fact is still judged exactly.

        `special`: with a locked actuator, or at a frame.
        """
        world, planner = self._world, self.planner
        if in_order and special:
            self._lock()
        instance = world.executor.instances
        if not in_order and special:
            self._kill_at_rpdo()
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

    def _kill_at_rpdo(self) -> None:
        """Kills the executor when an RPDO is handed out, or later if none is.

        Mostly the RPDO is of an actuator of which the next process cannot know whether it has switched.
        """
        world, bus = self._world, self._random.choice(list(self._world.buses.values()))
        arm = world.account.arm
        unseen = bits_of(arm.paired & ~arm.sensed & ~world.account.locked)
        if unseen and self._random.random() < 0.7:
            k = self._random.choice(unseen)
            bus = world.buses[world.arm.wiring.channels[k].bus]
            self.planner.ask_to_switch(k, times=6, pause=0.2)  # to and fro: it must be known before it contracts
            world.pass_time(self._random.uniform(0.1, 1.0))
        else:
            self.planner.ask_for_motion()
        bus.at_next_rpdo(lambda: world.agenda.after(0.0, world.executor.kill))
        world.pass_time(self._random.uniform(0.1, 0.4))
        bus.await_no_rpdo()

    def _lock(self) -> None:
        """Locks an actuator where it is, if an end-stop tells its state; the executor that ends has it locked."""
        world = self._world
        free = world.account.arm.sensed & ~world.account.locked
        if free:
            extended = free & world.boards.positions()  # which `on_stop: contract` would contract
            k = self._random.choice(bits_of(extended if extended and self._random.random() < 0.7 else free))
            self.planner.ask_to_lock(k, world.boards.positions() >> k & 1)
            world.pass_time(ANSWERED)

    def _interrupt(self) -> None:
        """Stops the arm, or cancels its program, when a SYNC or an RPDO is handed out."""
        world, planner, bus = self._world, self.planner, self._random.choice(list(self._world.buses.values()))
        planner.ask_for_motion()
        at_next = self._random.choice([bus.at_next_sync, bus.at_next_sync, bus.at_next_rpdo])
        dies = self._random.random() < 0.25

        def happen() -> None:
            planner.interrupt()
            if dies:
                planner.die()

        at_next(lambda: world.agenda.after(0.0, happen))
        world.pass_time(self._random.uniform(0.3, 1.0))
        at_next(lambda: None)
        world.wait(world.settled, "ready", world.ready_within)

    def _lose_planner(self, dies: bool) -> None:
        """Makes the planner die or stand still while a program may run; each fact is still judged exactly."""
        world, planner, timeout = self._world, self.planner, self._world.arm.planner_timeout
        if self._random.random() < 0.7:
            planner.ask_for_motion()
            world.pass_time(self._random.uniform(0.0, 0.3))
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


def _drill(drill: Callable[[], None], place: object) -> Fault:
    return Fault(drill)
