"""The kinds of single faults: how each is caused and mended, and what must be told of it."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from random import Random
from typing import TYPE_CHECKING

from hyperbit.controller.executor.core.events import Defect
from hyperbit.drivers.canopen.wire import cia301
from hyperbit.drivers.canopen.wire.cia301 import Command, Frame
from hyperbit.drivers.canopen.wire.events import BusOverrun, FrameReceived
from hyperbit.drivers.simulation.buses import ORDINARY
from tests.simulation.board_faults import BoardFaults
from tests.simulation.executor.process import LOOP_FAILS
from tests.simulation.judge.expected import Expected
from tests.simulation.planner import ScriptedPlanner
from tests.simulation.pulse_faults import PulseFaults
from tests.simulation.single_fault import ASKED, AT_ONCE, NO_FAULT, READ_AT_ONCE, READ_BACK, Fault, codes, nothing

if TYPE_CHECKING:
    from tests.simulation.buses.bus_model import BusModel
    from tests.simulation.world import World

SHOWN = 0.1  # [s] until a warning is told, by the next snapshot
RESTARTS = 0.5  # [s] until a board without supply has booted
OVERRUNS, OVERRUN_EVERY = 25, 0.02  # number, and time between two of them [s]
TIMES = 8  # stages that switch an actuator to and fro
LOOSE = 0.3  # [s] for which a wire is loose; a board that does not answer for longer is a fault
WAYS = {"clear": "answers", "touched": "finds an obstacle", "silent": "is silent", "stream": "sends set-points"}


class FaultKinds:
    """Makes faults for the arm as it stands."""

    def __init__(self, world: World, random: Random) -> None:
        self._world, self._random = world, random
        self._boards, self._pulses = BoardFaults(world, random), PulseFaults(world, random)

    def possible(self) -> dict[str, Fault]:
        """Returns the faults that the arm permits now, each of a drawn part."""
        makers = [self._of_bus, self._of_board, self._of_frames, self._of_actuator, self._of_motion, self._of_executor]
        made: dict[str, Fault] = {}
        for maker in [*makers, self._of_running_boards, self._pulses.draw]:
            made |= maker()
        return made

    def _of_running_boards(self) -> dict[str, Fault]:
        return {name: Fault(*made) for name, made in self._boards.draw().items()}

    def _of_bus(self) -> dict[str, Fault]:
        world, timing = self._world, self._world.arm.timing
        bus = self._random.choice(list(world.buses.values()))
        boards = tuple(name for name in world.boards.simulated.names if name.startswith(bus.name))
        silent = timing.heartbeat_timeout + timing.heartbeat + AT_ONCE

        def cleared(within: float, *names: str) -> Expected:
            return Expected(codes(*names), (bus.name, *boards), within, cleared=True)

        def set_(name: str, value: object) -> Callable[[], None]:
            return lambda: setattr(bus, name, value)

        stuck = cleared(silent, "board-lost", "bus-busy")
        return {
            "bus is down": Fault(bus.go_down, bus.restore, cleared(AT_ONCE, "bus-down")),
            "bus-off": Fault(bus.go_off, bus.restore, cleared(AT_ONCE, "bus-off")),
            "bus is unacknowledged": Fault(set_("acknowledged", False), bus.restore, stuck),
            "queue is full": Fault(set_("capacity", 0), bus.restore, stuck),
            "bus-passive": Fault(bus.warn, bus.restore, cleared(SHOWN, "bus-passive")),
            "overruns": Fault(self._overrun(bus), nothing, NO_FAULT),
            "overrun": Fault(lambda: world.executor.post(BusOverrun(bus.name)), nothing, NO_FAULT),
            "frames come twice": Fault(set_("duplication", 0.2), bus.restore, NO_FAULT),
            "answers are late": Fault(set_("answer_delay", 0.05), bus.restore, NO_FAULT),
        }

    def _overrun(self, bus: BusModel) -> Callable[[], None]:
        """Returns what loses received frames again and again while an actuator is switched."""
        world, planner = self._world, self._world.planner
        assert isinstance(planner, ScriptedPlanner)

        def happen() -> None:
            for count in range(OVERRUNS):
                world.agenda.after(OVERRUN_EVERY * count, lambda: world.executor.post(BusOverrun(bus.name)))
            if not world.account.homing and not world.account.locked:
                planner.ask_to_switch(0)

        return happen

    def _of_board(self) -> dict[str, Fault]:
        timing, boards = self._world.arm.timing, self._world.boards
        names = list(boards.simulated.names)
        paired = [name for name in names if boards.names.get(name, 0) & self._world.account.arm.paired]
        board = self._random.choice(paired or names if self._random.random() < 0.5 else names)
        silent = 1.2 * timing.heartbeat_timeout + timing.heartbeat + AT_ONCE
        lost = Expected(codes("board-lost"), (board,), silent, also=codes("interlock"), cleared=True)
        cut = lost._replace(also=codes("interlock", "board-rebooted"), cleared=False)
        again = Expected(codes("board-rebooted"), (board,), RESTARTS, also=codes("interlock"))
        emergency = Expected(codes("emergency"), (board,), AT_ONCE)
        code = self._random.choice([0x2310, 0x3320, 0x8F00])

        def reboot() -> None:
            boards.fault("power_cut", board)
            boards.fault("power_on", board)

        def do(verb: str, *numbers: float | str) -> Callable[[], None]:
            return lambda: boards.fault(verb, board, *numbers)

        return {
            "board is silent": Fault(do("silence"), do("unsilence"), lost),
            "board without supply": Fault(do("power_cut"), do("power_on"), cut),
            "board reboots": Fault(reboot, nothing, again),
            "emergency": Fault(lambda: boards.emergency(board, code), nothing, emergency),
        }

    def _of_frames(self) -> dict[str, Fault]:
        """Returns frames that no other node may send."""
        world = self._world
        channel = self._random.choice(world.arm.wiring.channels)
        bus, node = channel.bus, channel.node
        first = min(c.node for c in world.arm.wiring.channels if c.bus == bus)
        foreign = Expected(codes("foreign-master"), (bus,), AT_ONCE)
        hurts = foreign._replace(also=codes("board-stopped", "interlock"))

        def send(cob_id: int, data: bytes, to_boards: bool = False) -> Callable[[], None]:
            def happen() -> None:
                if to_boards:
                    world.boards.hear_tool(bus, Frame(cob_id, data))
                world.executor.post(FrameReceived(bus, Frame(cob_id, data)))

            return happen

        pre_operational = bytes([Command.PRE_OPERATIONAL, node])
        board = world.boards.simulated.board(f"{bus}/{node}")
        tells = board.objects.has(0x6206) and not board.variant.off_outside_operational
        made = {
            "foreign NMT": Fault(
                send(cia301.NMT, pre_operational, to_boards=True),
                nothing,
                hurts,
                (lambda: board.pins) if tells else nothing,
            ),
            "foreign START": Fault(send(cia301.NMT, bytes([Command.START, 0])), nothing, foreign),
            "foreign SYNC": Fault(send(cia301.SYNC, b""), nothing, foreign),
            "foreign heartbeat": Fault(send(cia301.HEARTBEAT + 127, b"\x05"), nothing, foreign),
            "foreign RPDO": Fault(send(cia301.RPDO1 + first, bytes(8)), nothing, foreign),
        }
        if channel.input is not None:
            short = Expected(codes("wrong-length"), (f"{bus}/{node}",), AT_ONCE)
            made["short TPDO"] = Fault(send(cia301.TPDO1 + node, b""), nothing, short)
        return made

    def _of_actuator(self) -> dict[str, Fault]:
        """Returns faults of an actuator or interlock while nothing moves."""
        world, boards = self._world, self._world.boards
        k = self._random.randrange(len(world.arm.actuators))
        label, at = world.arm.actuators[k], boards.positions() >> k & 1
        made = {}
        if world.arm.wiring.interlocks:
            opened = Expected(codes("interlock"), ("door",), AT_ONCE, refused="interlock-open")
            made["door is opened"] = Fault(
                lambda: boards.door("door", is_open=True), lambda: boards.door("door", is_open=False), opened
            )
        if world.account.arm.sensed >> k & 1:
            moved = Expected(codes("unexpected-motion"), (label,), world.kinds.travel[k][1 - at] + ASKED)
            made["actuator moves by itself"] = Fault(
                lambda: boards.fault("stick", label, 1 - at), lambda: boards.fault("release", label), moved
            )
        if world.account.arm.extended_ends & world.account.arm.contracted_ends & 1 << k:
            channel = world.arm.wiring.channels[k]
            if not channel.inverted & {"input", "input_contracted"}:
                both = Expected(codes("end-stops"), (label,), ASKED)
                made["wires are shorted"] = Fault(
                    lambda: boards.fault("short_wires", label), lambda: boards.fault("restore_sensor", label), both
                )
        return made

    def _of_motion(self) -> dict[str, Fault]:
        """Returns faults of one actuator that is switched."""
        world, boards, planner = self._world, self._world.boards, self._world.planner
        assert isinstance(planner, ScriptedPlanner)
        free = [k for k in range(len(world.arm.actuators)) if not world.account.locked >> k & 1]
        if not free or world.account.homing:
            return {}
        k = self._random.choice(free)
        channel, at = world.arm.wiring.channels[k], boards.positions() >> k & 1
        label, board = channel.actuator, f"{channel.bus}/{channel.node}"
        bus: BusModel = world.buses[channel.bus]
        late = max(world.kinds.travel[k]) + world.kinds.margin[k] + world.arm.rest + ASKED

        def stick() -> None:
            boards.fault("stick", label, at)
            planner.ask_to_switch(k)

        def lose_tpdo() -> None:
            bus.tpdos_to_lose = 1
            planner.ask_to_switch(k)

        def lose_sync() -> None:
            boards.loses = board, cia301.SYNC
            planner.ask_to_switch(k)

        travel, margin = world.kinds.travel[k][1 - at], world.kinds.margin[k]

        def dawdle() -> None:
            boards.fault("slow", label, (travel + 0.7 * margin) / (ORDINARY * travel))
            planner.ask_to_switch(k)

        pause = max(world.kinds.travel[k]) + world.kinds.margin[k] / 2 + world.arm.rest

        def miss() -> None:
            boards.fault("stick", label, at)
            planner.ask_to_switch(k, times=TIMES, pause=pause)

        made = {}
        if world.account.arm.sensed >> k & 1:
            cleared, also = world.arm.continue_on_stuck, codes("unexpected-motion")
            stuck = Expected(codes("stuck"), (label,), late, also=also, cleared=cleared, locks=(label, cleared))
            made["actuator is stuck"] = Fault(stick, lambda: boards.fault("release", label), stuck)
            missed = stuck._replace(within=TIMES * pause + late)
            if not cleared:
                made["actuator misses commands"] = Fault(miss, lambda: boards.fault("release", label), missed)
            others = [j for j in free if j != k]
            loose = world.boards.positions() >> k & 1 and world.account.arm.extended_ends >> k & 1 and others
            tells = channel.input_contracted is None and "input" not in channel.inverted
            if loose and tells and not world.account.locked:
                way = self._random.choice(list(WAYS))
                cause = partial(self._loosen, label, bus, partial(planner.ask_strictly, others[0], way))
                asks = NO_FAULT._replace(asks=True)
                made[f"wires are loose, the planner {WAYS[way]}"] = Fault(cause, nothing, asks)
            made["TPDO is lost"] = Fault(lose_tpdo, nothing, NO_FAULT)
            made["actuator arrives within its margin"] = Fault(dawdle, lambda: boards.fault("slow", label, 1), NO_FAULT)
        if channel.pulse is None and not world.account.arm.forgone >> k & 1:
            also = codes("stuck", "not-switched", "unexpected-motion")
            at_once = READ_AT_ONCE + world.arm.rest
            within = READ_BACK + late if world.account.arm.sensed >> k & 1 else at_once
            unheard = Expected(also, (label, board), within, also=also)
            made["a board loses a SYNC"] = Fault(lose_sync, nothing, unheard)
        return made

    def _loosen(self, label: str, bus: BusModel, ask: Callable[[], None]) -> None:
        """Cuts the wires of an end-stop for a moment, in which its board cannot be asked, before a strict stage."""
        boards, agenda = self._world.boards, self._world.agenda
        bus.mute = True
        boards.fault("cut_wires", label)
        agenda.after(LOOSE / 5, ask)
        agenda.after(LOOSE, lambda: boards.fault("restore_sensor", label))
        agenda.after(LOOSE, bus.hear_answers)

    def _of_executor(self) -> dict[str, Fault]:
        executor, timing = self._world.executor, self._world.arm.timing
        short = (timing.heartbeat_timeout - timing.heartbeat) * 0.7
        long = timing.heartbeat_timeout * self._random.choice([1.3, 3.0]) + self._random.choice([0.1, 1.0, 20.0])
        also = codes("interlock", "board-stopped", "emergency", "board-lost")
        halted = Expected(codes("halted"), ("executor",), long + AT_ONCE, also=also)
        defect = Expected(codes("internal-error"), ("executor",), AT_ONCE)
        return {
            "executor's loop fails": Fault(lambda: executor.post(Defect(LOOP_FAILS)), nothing, defect),
            "executor stalls for a moment": Fault(lambda: executor.stall(short), nothing, NO_FAULT),
            "executor stands still": Fault(lambda: executor.stall(long), nothing, halted),
        }
