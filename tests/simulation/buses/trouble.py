"""Faults at random times, and their ends."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from functools import partial
from random import Random
from typing import TYPE_CHECKING

from hyperbit.drivers.canopen.wire import cia301
from hyperbit.drivers.canopen.wire.cia301 import Command, Frame
from hyperbit.drivers.canopen.wire.events import FrameReceived

if TYPE_CHECKING:
    from tests.simulation.buses.bus_model import BusModel
    from tests.simulation.whole.daemon import Daemon
    from tests.simulation.world import World

KINDS = {
    **{"executor stalls": 2.0, "executor is killed": 1.0, "executor is restarted": 1.0},
    **{"planner hangs": 1.0, "planner dies": 1.0},
    **{"bus is down": 0.6, "bus-off": 0.6, "bus is unacknowledged": 0.6, "queue is full": 1.0, "bus-passive": 0.5},
    **{"frames are lost": 0.4, "frames come twice": 0.5, "answers are late": 0.6, "strange frame": 1.0},
    **{"board without supply": 0.8, "board is silent": 0.8, "board reboots": 0.8, "emergency": 0.6},
    **{"actuator is stuck": 0.8, "actuator is slow": 0.6, "sensor is lost": 0.5, "actuator is jammed": 0.5},
    **{"wires are cut": 0.3, "wires are shorted": 0.3, "door is opened": 4.0},
    **{"echoes are lost": 0.5, "foreign NMT": 0.5, "answers are lost": 0.5, "TPDO is lost": 0.5},
    **{"kill in mid boot": 0.4, "bus-off in mid boot": 0.4, "power-cycle in mid boot": 0.4},
    **{"stop in mid commit": 0.8, "wires are loose": 7.0},
}


DAEMON_KINDS = {
    **{"planner is restarted": 2.0, "both are killed": 1.0, "planner is slow": 0.8, "planner dies": 3.0},
    **{"executor dies in motion": 5.0, "planner dies in motion": 2.0},
    **{
        "searches are late": 1.0,
        "searches fail": 0.8,
        "a search hangs": 0.02,
        "disk is full": 0.6,
        "clock is set": 2.0,
        "clients read slowly": 0.5,
        "planner stands still": 0.4,
        "network is lost": 1.6,
        "executor's socket is full": 1.5,
        "searches err": 2.0,
    },
}

FOREIGN = (Command.PRE_OPERATIONAL, Command.STOP, Command.START, Command.RESET_COMMUNICATION)
MID_BOOT = 0.3  # [s], longest time from a start of the executor to a fault in its boot

LONGEST_STALL, LONGEST_STANDSTILL = 3.0, 20.0  # [s] of executor or planner; of a planner that stands still


class Trouble:
    """Causes a fault about once a second; each fault ends after a time.

    Attributes:
        kinds: weights of the kinds; a world has only some of them.
    """

    def __init__(self, world: World, random: Random) -> None:
        self.made: Counter[str] = Counter()
        self._world, self._random = world, random
        self._active = False
        self._round = 0
        kinds = KINDS if world.daemon is None else KINDS | DAEMON_KINDS
        self.kinds = {kind: weight for kind, weight in kinds.items() if random.random() < 0.6} or dict(KINDS)
        self._mean = random.choice([0.3, 1.0, 3.0])

    def begin(self) -> None:
        self._active, self._round = True, self._round + 1
        self._next(self._round)

    def end(self) -> None:
        self._active = False
        self._world.mend()

    def _next(self, turn: int) -> None:
        def happen() -> None:
            if self._active and turn == self._round:
                kind = self._random.choices(list(self.kinds), list(self.kinds.values()))[0]
                self.made[kind] += 1
                self._world.note(f"fault: {kind}")
                self._make(kind)
                self._next(turn)

        self._world.agenda.after(self._random.expovariate(1 / self._mean), happen)

    def _later(self, longest: float, mend: Callable[[], None]) -> None:
        """Ends a fault after a random time, unless all faults have ended before."""
        turn = self._round

        def happen() -> None:
            if self._active and turn == self._round:
                mend()

        self._world.agenda.after(self._random.uniform(0.0, longest), happen)

    def _make(self, kind: str) -> None:
        world, random = self._world, self._random
        bus = random.choice(list(world.buses.values()))
        channel = random.choice(world.arm.wiring.channels)
        board, label = f"{channel.bus}/{channel.node}", channel.actuator
        match kind:
            case "executor stalls":
                world.executor.stall(random.choice([0.015, 0.05, 0.2, 1.0, LONGEST_STALL]))
            case "executor is killed":
                if world.daemon is not None and random.random() < 0.5:
                    world.daemon.clients.rush()
                world.executor.kill_after(random.randint(0, 20))
            case "executor is restarted":
                world.executor.quit()
            case "planner hangs":
                stall = partial(world.planner.stall, random.choice([0.3, 0.9, 1.2, LONGEST_STALL]))
                delay = 0.0 if world.daemon is None else world.daemon.clients.hurry()
                world.agenda.after(delay, stall)
            case "planner dies":
                world.planner.die()
            case "bus is down":
                bus.go_down()
                self._later(1.0, bus.restore)
            case "bus-off":
                bus.go_off()
                self._later(1.0, bus.restore)
            case "bus is unacknowledged":
                bus.acknowledged = False
                self._later(1.0, bus.restore)
            case "queue is full":
                bus.capacity = random.choice([0, 1, 2])
                self._later(0.3, bus.restore)
            case "bus-passive":
                bus.warn()
                self._later(1.0, bus.restore)
            case "frames are lost":
                bus.loss = random.choice([0.01, 0.1])
                self._later(0.5, bus.restore)
            case "frames come twice":
                bus.duplication = 0.1
                self._later(2.0, bus.restore)
            case "answers are late":
                bus.answer_delay = random.choice([0.02, 0.2, 0.8])
                self._later(2.0, bus.restore)
            case "strange frame":
                own = [function + channel.node for function in (0x80, 0x180, 0x580, 0x580, 0x700)]
                cob_id = random.choice([random.randrange(0x800), 0x77F, 0x80, *own])
                frame = Frame(cob_id, random.randbytes(random.randint(0, 8)))
                world.executor.post(FrameReceived(bus.name, frame))
            case "foreign NMT":
                frame = Frame(cia301.NMT, bytes([random.choice(FOREIGN), random.choice([0, channel.node])]))
                world.boards.hear_tool(channel.bus, frame)
                world.executor.post(FrameReceived(channel.bus, frame))
            case "answers are lost":
                bus.mute = True
                world.agenda.after(random.uniform(0.5, 3.0), bus.hear_answers)
            case "echoes are lost":
                bus.echoes = False
                self._later(1.0, bus.restore)
            case "TPDO is lost":
                bus.tpdos_to_lose = 1
            case "kill in mid boot":
                self._in_mid_boot(world.executor.kill)
            case "bus-off in mid boot":
                self._in_mid_boot(bus.go_off)
                self._later(2.0, bus.restore)
            case "power-cycle in mid boot":
                self._in_mid_boot(lambda: self._break("board reboots", board, label))
            case "wires are loose":
                self._at_strict_stages(self._loosen)
            case "stop in mid commit":
                bus.at_next_rpdo(lambda: self._stop_in_mid_commit(bus))
            case _ if kind in DAEMON_KINDS and world.daemon is not None:
                self._disturb(kind, world.daemon)
            case _:
                self._break(kind, board, label)

    def _disturb(self, kind: str, daemon: Daemon) -> None:
        random, mood = self._random, daemon.mood
        match kind:
            case "planner is restarted":
                daemon.end_in_order()
            case "executor dies in motion":
                daemon.clients.move()
                self._in_motion(self._world.executor.kill)
            case "planner dies in motion":
                self._in_motion(daemon.die)
            case "both are killed":
                daemon.die()
                self._world.executor.kill_after(random.randint(0, 20))
            case "planner is slow":
                daemon.hold_up(slow=random.choice([0.002, 0.02, 0.2]))
                self._later(4.0, daemon.mend)
            case "searches are late":
                mood.delay = random.choice([0.1, 0.5, 3.0])
                self._later(6.0, mood.mend)
            case "searches fail":
                mood.fails = random.choice([0.1, 0.5, 1.0])
                self._later(3.0, mood.mend)
            case "a search hangs":
                mood.hangs = True
            case "disk is full":
                daemon.fill_disk(random.choice([0, 0, 1, 2, 5]))
                self._later(4.0, daemon.mend)
            case "clients read slowly":
                daemon.hold_up(congestion=random.choice([0.005, 0.1]))
                self._later(3.0, daemon.mend)
            case "planner stands still":
                daemon.stall(random.choice([5.0, 12.0, LONGEST_STANDSTILL]))
            case "searches err":
                daemon.search.errs = 0.5
                self._later(4.0, lambda: setattr(daemon.search, "errs", 0.0))
            case "network is lost":
                daemon.lose_network(True)
                self._later(3.0, lambda: daemon.lose_network(False))
            case "executor's socket is full":
                daemon.fill_socket(random.choice([0, 0, 1, 2, 5]))
                self._later(random.choice([0.1, 0.5, 3.0]), daemon.drain_socket)
            case "clock is set":
                daemon.set_clock(random.choice([-3600.0, -1.0, -0.1, 0.1, 1.0, 3600.0]))

    def _ask_to_reset(self) -> None:
        """Asks for a reset, as an operator does who does not see that a door is open."""
        world = self._world
        if world.daemon is not None:
            world.daemon.clients.ask("reset")
        elif world.planner.snapshot is not None and world.planner.connection.client is not None:
            world.planner.ask_to_reset()

    def _at_strict_stages(self, happen: Callable[[], None]) -> None:
        """Lets something happen soon after the begin of each second stage that must be clear, until the calm."""
        turn = self._round

        def consider(bus: BusModel) -> None:
            if not self._active or turn != self._round:
                return
            strict = any(motion.strict for motion in self._world.account.wanted)
            if strict and self._random.random() < 0.9:
                self._world.agenda.after(self._random.uniform(0.0, 0.05), happen)
            bus.at_next_rpdo(partial(consider, bus))

        for bus in self._world.buses.values():
            bus.at_next_rpdo(partial(consider, bus))

    def _loosen(self) -> None:
        """Cuts the wires of an extended actuator for a moment, while its board answers late.

        The next stage then begins from other states than planned before the executor knows that the wires are cut.
        """
        world, random = self._world, self._random
        channels, positions = world.arm.wiring.channels, world.boards.positions()
        one = [c.input is not None and c.input_contracted is None and "input" not in c.inverted for c in channels]
        extended = [c for k, c in enumerate(channels) if one[k] and positions >> k & 1]
        if not self._active or not extended:
            return
        channel = random.choice(extended)
        bus = world.buses[channel.bus]
        bus.answer_delay = 1.0
        world.boards.fault("cut_wires", channel.actuator)
        self._later(1.0, lambda: world.boards.fault("restore_sensor", channel.actuator))
        self._later(1.0, bus.restore)

    def _in_motion(self, happen: Callable[[], None]) -> None:
        """Lets something happen once, soon after the next stage has begun."""
        turn, delay = self._round, self._random.uniform(0.0, 0.2)
        waits = [True]

        def perform() -> None:
            if self._active and turn == self._round and waits and waits.pop():
                self._world.agenda.after(delay, happen)

        for bus in self._world.buses.values():
            bus.at_next_rpdo(perform)

    def _stop_in_mid_commit(self, bus: BusModel) -> None:
        """Keeps the frames of a commit in the controller for a while, and halts the arm."""
        if self._active:
            bus.acknowledged = False
            self._later(0.15, bus.restore)
            self._world.planner.connection.halt()

    def _in_mid_boot(self, happen: Callable[[], None]) -> None:
        """Restarts the executor, and lets something happen soon after its start."""
        turn, delay = self._round, self._random.uniform(0.0, MID_BOOT)

        def perform() -> None:
            if self._active and turn == self._round:
                happen()

        self._world.executor.at_next_start(lambda: self._world.agenda.after(delay, perform))
        self._world.executor.kill()

    def _break(self, kind: str, board: str, label: str) -> None:
        world, random = self._world, self._random
        match kind:
            case "board without supply":
                world.boards.fault("power_cut", board)
                self._later(1.0, lambda: world.boards.fault("power_on", board))
            case "board is silent":
                world.boards.fault("silence", board)
                self._later(1.0, lambda: world.boards.fault("unsilence", board))
            case "board reboots":
                world.boards.fault("power_cut", board)
                world.boards.fault("power_on", board)
            case "emergency":
                world.boards.emergency(board, random.choice([0x2310, 0x3320, 0x0000, random.randrange(0x10000)]))
            case "actuator is stuck":
                world.boards.fault("stick", label, random.randint(0, 1))
                self._later(4.0, lambda: world.boards.fault("release", label))
            case "actuator is slow":
                world.boards.fault("slow", label, random.choice([0.5, 2.5, 20]))
                self._later(4.0, lambda: world.boards.fault("slow", label, 1))
            case "sensor is lost":
                world.boards.fault("lose_sensor", label)
                self._later(4.0, lambda: world.boards.fault("restore_sensor", label))
            case "actuator is jammed":
                world.boards.fault("jam", label, random.choice([0.0, 0.02, 0.5, 1.0]))
                self._later(4.0, lambda: world.boards.fault("release", label))
            case "wires are cut" | "wires are shorted":
                world.boards.fault("cut_wires" if kind == "wires are cut" else "short_wires", label)
                self._later(4.0, lambda: world.boards.fault("restore_sensor", label))
            case "door is opened" if world.arm.wiring.interlocks:
                world.boards.door("door", is_open=True)
                self._later(2.0, lambda: world.boards.door("door", is_open=False))
                self._later(0.5, self._ask_to_reset)
