"""Volleys: switches one after another, each with a disturbance that the executor must bear without a fault."""

from __future__ import annotations

from collections.abc import Callable
from random import Random
from typing import TYPE_CHECKING

from hyperbit.drivers.canopen.wire import cia301
from tests.simulation.judge.expected import told
from tests.simulation.planner import ScriptedPlanner
from tests.simulation.single_fault import NO_FAULT, nothing

if TYPE_CHECKING:
    from tests.simulation.world import World

ROUNDS = 7
MANY = 3  # numbers of switches to choose from: they come as soon as possible
LONGEST_HOLD = 0.015  # [s] for which frames stay in the controller, far below each time-out
LATE = 0.08  # [s] of late answers
ECHO_LOST = 0.05  # [s] after which the executor knows that an echo was lost
DISTURBED = 0.12  # [s] of a round


class Volleys:
    def __init__(self, world: World, random: Random) -> None:
        self._world, self._random = world, random

    def happen(self) -> None:
        """Switches a few actuators, each with another disturbance; nothing may be told of these."""
        world, random, planner = self._world, self._random, self._world.planner
        assert isinstance(planner, ScriptedPlanner)
        free = [k for k in range(len(world.arm.actuators)) if not world.account.locked >> k & 1]
        if not free or world.account.homing:
            return
        world.disturb()
        names = list(self._of(planner, free[0]))
        for name in random.sample(names, min(ROUNDS, len(names))):
            fit = [k for k in free if self._of(planner, k)[name] is not None]
            if not fit:
                continue
            weights = [1 + 2 * (k in world.kinds.pulse) + 2 * (not world.account.arm.sensed >> k & 1) for k in fit]
            k = random.choices(fit, weights)[0]
            cause = self._of(planner, k)[name]
            assert cause is not None
            world.trouble.made[f"volley: {name}"] += 1
            world.note(f"volley: {name} of actuator {k}")
            cause()
            self._pass(DISTURBED + world.kinds.pulse.get(k, 0.0))
            self._mend()
            world.wait(world.settled, f"ready after {name}", world.ready_within)
            world.wait(lambda: not world.boards.coils() & world.kinds.pulsed, f"released after {name}", 2.0)
            self._pass(DISTURBED)

    def _pass(self, seconds: float) -> None:
        until = self._world.agenda.now + seconds
        while self._world.agenda.now < until:
            self._world.one_step()
            told(NO_FAULT, self._world.planner.snapshot)

    def _mend(self) -> None:
        self._world.boards.loses = None
        for bus in self._world.buses.values():
            bus.at_next_sync(nothing)
            bus.await_no_rpdo()
            bus.lose_echo(0)
            bus.restore()

    def _of(self, planner: ScriptedPlanner, k: int) -> dict[str, Callable[[], None] | None]:
        """Returns the disturbances by name; None where one would be a fault of this actuator."""
        world, random = self._world, self._random
        channel, pulse = world.arm.wiring.channels[k], world.kinds.pulse.get(k)
        bus, board = world.buses[channel.bus], f"{channel.bus}/{channel.node}"
        after, agenda = random.uniform(0.001, LONGEST_HOLD), world.agenda
        blind = not world.account.arm.sensed >> k & 1

        def switch(*times: int) -> None:
            pause = max(world.kinds.travel[k]) + ECHO_LOST * (len(times) < MANY)
            planner.ask_to_switch(k, random.choice(times or (1,)), pause, strict=random.random() < 0.5)

        def hold() -> None:
            """Frames stay in the controller for a moment."""
            bus.stuck = True
            agenda.after(after, go_on)

        def go_on() -> None:
            bus.stuck = False
            bus.begin()

        def hold_and_cancel() -> None:
            hold()
            agenda.after(0.0, planner.cancel_now)
            if random.random() < 0.7:
                other = random.randrange(len(world.arm.actuators))
                agenda.after(after * random.uniform(0.1, 1.3), lambda: ask_again(other))

        def ask_again(other: int) -> None:
            if planner.snapshot is not None and not world.account.locked >> other & 1:
                planner.ask_to_switch(other)

        def fill() -> None:
            """No further frame is taken for a moment."""
            bus.capacity = 0
            agenda.after(after, bus.restore)

        def at_release(happen: Callable[[], object]) -> Callable[[], None]:
            """Lets something happen in the middle of the pulse."""

            def cause() -> None:
                bus.at_next_sync(lambda: agenda.after((pulse or 0.0) / 2, happen))
                switch()

            return cause

        def at(when: Callable[[Callable[[], None]], None], happen: Callable[[], None]) -> Callable[[], None]:
            def cause() -> None:
                when(happen)
                switch(1, 2, 3)

            return cause

        def with_(name: str, value: float) -> Callable[[], None]:
            def cause() -> None:
                setattr(bus, name, value)
                switch(2, 3, 4)

            return cause

        def lose_echo(sync: bool) -> Callable[[], None]:
            def cause() -> None:
                bus.lose_echo(1, sync)
                switch(2, 3)  # the last one is known in time

            return cause

        def stop() -> None:
            planner.halt()

        def lose() -> None:
            world.boards.loses = board, random.choice([cia301.RPDO1, cia301.SYNC])

        return {
            "RPDOs wait": at(bus.at_next_rpdo, hold),
            "SYNC waits": at(bus.at_next_sync, hold),
            "canceled while RPDOs wait": at(bus.at_next_rpdo, hold_and_cancel),
            "canceled while SYNC waits": at(bus.at_next_sync, hold_and_cancel),
            "the queue is full after an RPDO": at(bus.at_next_rpdo, fill),
            "the echo of an RPDO is lost": lose_echo(sync=False),
            "the echo of a SYNC is lost": lose_echo(sync=True),
            "frames come twice": with_("duplication", 0.3),
            "answers are late": None if blind and pulse is not None else with_("answer_delay", LATE),
            "RPDOs wait at the end of a pulse": None if pulse is None else at_release(lambda: bus.at_next_rpdo(hold)),
            "stopped in a pulse": None if pulse is None else at_release(stop),
            "canceled in a pulse": None if pulse is None else at_release(planner.cancel_now),
            "a board loses the end of a pulse": None if pulse is None else at_release(lose),
            "the echo of the end of a pulse is lost": None if pulse is None else at_release(bus.lose_echo),
        }
