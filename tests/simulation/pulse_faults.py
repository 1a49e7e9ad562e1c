"""Faults of pulses: frames that begin or end them are lost, their bus or another one fails."""

from __future__ import annotations

from collections.abc import Callable
from random import Random
from typing import TYPE_CHECKING

from hyperbit.drivers.canopen.wire import cia301
from tests.simulation.judge.expected import Expected
from tests.simulation.planner import ScriptedPlanner
from tests.simulation.single_fault import ASKED, AT_ONCE, NO_FAULT, READ_BACK, Fault, codes, nothing

if TYPE_CHECKING:
    from tests.simulation.world import World

SHORT = 0.03  # [s]: a pulse that cannot be read twice is given again, unless an end-stop tells
OVERDUE = 2.0  # [s] until a pulse that may be on, and cannot be ended, is told
RESTARTS = 0.5  # [s] until a board without supply has booted
PULSING = 0.008  # [s] from the SYNC that begins a pulse until its bus goes down


class PulseFaults:
    """Draws faults of pulses."""

    def __init__(self, world: World, random: Random) -> None:
        self._world, self._random = world, random

    def draw(self) -> dict[str, Fault]:
        """Returns faults of frames that begin or end a pulse, and of a bus beside it; none if no pulse can be drawn."""
        world, boards, planner = self._world, self._world.boards, self._world.planner
        assert isinstance(planner, ScriptedPlanner)
        free = [k for k in world.kinds.pulse if not world.account.locked >> k & 1]
        if not free or world.account.homing:
            return {}
        k = self._random.choice(free)
        channel, pulse = world.arm.wiring.channels[k], world.kinds.pulse[k]
        board, bus, timing = f"{channel.bus}/{channel.node}", world.buses[channel.bus], world.arm.timing
        silent = timing.heartbeat_timeout + timing.heartbeat + AT_ONCE + world.arm.rest
        others = [other for name, other in world.buses.items() if name != channel.bus]
        frame = self._random.choice([cia301.RPDO1, cia301.SYNC])

        def switch(happen: Callable[[], object], after: float) -> Callable[[], None]:
            def cause() -> None:
                bus.at_next_sync(lambda: world.agenda.after(after, happen))
                planner.ask_to_switch(k)

            return cause

        def lose() -> None:
            boards.loses = board, frame

        def mute() -> None:
            bus.mute = True
            world.agenda.after(pulse, bus.hear_answers)

        def unplug() -> None:
            boards.fault("silence", board)

        def restart() -> None:
            boards.fault("power_cut", board)
            boards.fault("power_on", board)

        def plug() -> None:
            disarm()
            boards.fault("unsilence", board)

        def hold_others() -> None:
            for other in others:
                other.acknowledged = False

        def release_others() -> None:
            disarm()
            for other in others:
                other.restore()

        def disarm() -> None:
            boards.loses = None
            bus.at_next_sync(nothing)
            bus.lose_echo(0)

        def cut_others() -> None:
            for other in others:
                other.go_down()

        def restore() -> None:
            disarm()
            bus.restore()

        late = READ_BACK + max(world.kinds.travel[k]) + world.kinds.margin[k] + world.arm.rest
        unheard = codes("stuck", "not-switched", "unexpected-motion", "pulse-overdue")
        begins = Expected(unheard, (channel.actuator, board), late, also=unheard)
        lost = Expected(
            codes("board-lost"), (board,), silent + pulse, also=codes("pulse-overdue", "stuck"), cleared=True
        )
        also = codes("interlock", "stuck", "pulse-overdue", "unexpected-motion")
        restarted = Expected(codes("board-rebooted"), (board,), RESTARTS + pulse + world.arm.rest, also=also)
        also = codes("pulse-overdue", "board-lost")
        doubtful = Expected(
            codes("pulse-overdue"), (channel.place,), OVERDUE, also=codes("bus-down", "stuck"), cleared=True
        )
        down = Expected(codes("bus-down"), (bus.name,), world.arm.rest + ASKED, also=also, cleared=True)
        made = {
            "a board loses the end of a pulse": Fault(switch(lose, pulse / 2), disarm, NO_FAULT),
            "an echo is lost while a pulse ends": Fault(switch(bus.lose_echo, pulse / 2), disarm, NO_FAULT),
            "a board is unplugged while it gets a pulse": Fault(switch(unplug, 0.0), plug, lost),
            "a board restarts in a pulse": Fault(switch(restart, pulse / 2), disarm, restarted),
            "bus is down while a pulse is on": Fault(switch(bus.go_down, PULSING), restore, down),
            "bus is down as a pulse begins": Fault(switch(bus.go_down, 0.0), restore, doubtful),
        }
        told = world.account.arm.sensed >> k & 1 or pulse > SHORT
        judged = told and not world.account.arm.forgone >> k & 1
        if told:  # answers that were lost may still come, so a short pulse is not surely read
            made["nobody answers during a pulse"] = Fault(switch(mute, 0.0), disarm, NO_FAULT)
        if frame == cia301.SYNC and not world.arm.continue_on_stuck and judged:
            made["a board loses the SYNC of a pulse"] = Fault(switch(lose, 0.0), disarm, begins)
        if others:
            names = tuple(name for name in (*world.buses, *boards.simulated.names) if not name.startswith(channel.bus))
            stuck = Expected(codes("board-lost", "bus-busy"), names, silent, also=codes("stuck"), cleared=True)
            also = codes("board-lost", "stuck")
            cut = Expected(codes("bus-down"), tuple(world.buses), AT_ONCE + world.arm.rest, also=also, cleared=True)
            made["another bus is down while a pulse ends"] = Fault(switch(cut_others, 0.0), release_others, cut)
            made["another bus is stuck while a pulse ends"] = Fault(switch(hold_others, 0.0), release_others, stuck)
        return made
