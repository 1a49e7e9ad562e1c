"""One fault at a time in an otherwise undisturbed world, with what the executor must tell of it."""

from __future__ import annotations

from collections.abc import Callable
from random import Random
from typing import TYPE_CHECKING, NamedTuple

from drivers.canopen.wire import cia301
from drivers.canopen.wire.cia301 import Command, Frame
from drivers.canopen.wire.events import BusOverrun, FrameReceived
from tests.simulation.judge.expected import Expected, told
from tests.simulation.judge.verdict import require
from tests.simulation.planner import ScriptedPlanner

if TYPE_CHECKING:
    from tests.simulation.world import World

AT_ONCE = 0.05  # [s] until a frame on a slow bus, or a change of a bus, is told
NOTHING = 1.0  # [s] for which it is watched that nothing is told
SUPERVISED = 0.6  # [s] until the last motion is supervised, and all outputs are read back after a pulse
KEPT = 1.5  # [s] for which a fault must wait for its reset; faults that clear are tried once a second

# What the executor gets wrong today. A later change widens these places, and removes the names here:
# - an actuator without end-stops that is unplugged, or loses a pulse, is believed (`E1`, `E2`): boards are only cut off
#   while no pulse is on, and states are compared only where a board was heard all the time.
BELIEVED = frozenset({"pulse while unplugged", "lost release"})


class Fault(NamedTuple):
    """A fault that can be caused and mended."""

    cause: Callable[[], object]
    mend: Callable[[], object]
    expected: Expected


def codes(*names: str) -> frozenset[str]:
    """Returns codes of faults."""
    return frozenset(names)


class SingleFaults:
    """Draws single faults, and judges what the executor tells of them.

    Args:
        world: with a scripted planner.
        random: draws.
    """

    def __init__(self, world: World, random: Random) -> None:
        self._world, self._random = world, random

    def happen(self) -> None:
        """Causes one fault, mends it, and brings the arm back.

        Raises:
            Violation: it is not told in time, or something else is told, or the arm does not become ready.
        """
        world, planner = self._world, self._world.planner
        assert isinstance(planner, ScriptedPlanner)
        planner.be_calm(True)
        planner.patient = True
        world.wait(world.settled, "ready", 15.0)
        world.wait(lambda: not world.boards.coils() & world.kinds.pulsed, "without pulses", 15.0)
        world.pass_time(SUPERVISED)
        world.judge.disturb()
        name, fault = self._drawn()
        world.trouble.made[f"only: {name}"] += 1
        world.note(f"only fault: {name}")
        self._judge(name, fault)
        planner.patient = False

    def _judge(self, name: str, fault: Fault) -> None:
        world, expected = self._world, fault.expected
        fault.cause()
        began = world.agenda.now
        if expected.codes:
            world.wait(lambda: told(expected, world.planner.snapshot), f"told: {name}", expected.within)
        self._watch(expected, self._random.uniform(0.0, 0.5) if expected.codes else NOTHING)
        fault.mend()
        if not expected.codes:
            self._watch(expected, 0.2)
            snapshot = world.planner.snapshot
            require(snapshot is not None and snapshot.mode == "ready", f"{name} ends in {snapshot}")
            return
        if not expected.cleared:
            self._watch(expected, KEPT)
            snapshot = world.planner.snapshot
            require(snapshot is not None and snapshot.mode == "fault", f"{name} does not wait for a reset: {snapshot}")
            assert isinstance(world.planner, ScriptedPlanner)
            world.planner.patient = False
        world.wait(world.settled, f"ready after {name}, which began at {began:g}", world.ready_within)

    def _watch(self, expected: Expected, seconds: float) -> None:
        until = self._world.agenda.now + seconds
        while self._world.agenda.now < until:
            self._world.one_step()
            told(expected, self._world.planner.snapshot)

    def _drawn(self) -> tuple[str, Fault]:
        makers = [self._of_bus, self._of_board, self._of_board, self._of_actuator, self._foreign, self._of_executor]
        while True:
            drawn = self._random.choice(makers)()
            if drawn is not None:
                return drawn

    def _of_bus(self) -> tuple[str, Fault] | None:
        world, timing = self._world, self._world.arm.timing
        bus = self._random.choice(list(world.buses.values()))
        silent = timing.heartbeat_timeout + timing.heartbeat + AT_ONCE
        boards = tuple(name for name in world.boards.names if name.startswith(bus.name))
        lost = codes("board-lost", "bus-busy")

        def unacknowledged() -> None:
            bus.acknowledged = False

        def full() -> None:
            bus.capacity = 0

        def late() -> None:
            bus.duplication = 0.2

        return self._random.choice(
            [
                (
                    "bus is down",
                    Fault(bus.go_down, bus.restore, Expected(codes("bus-down"), (bus.name,), AT_ONCE, cleared=True)),
                ),
                (
                    "bus-off",
                    Fault(bus.go_off, bus.restore, Expected(codes("bus-off"), (bus.name,), AT_ONCE, cleared=True)),
                ),
                (
                    "bus is unacknowledged",
                    Fault(unacknowledged, bus.restore, Expected(lost, (bus.name, *boards), silent, cleared=True)),
                ),
                ("queue is full", Fault(full, bus.restore, Expected(lost, (bus.name, *boards), silent, cleared=True))),
                (
                    "bus-passive",
                    Fault(bus.warn, bus.restore, Expected(codes("bus-passive"), (bus.name,), AT_ONCE, cleared=True)),
                ),
                (
                    "overrun",
                    Fault(lambda: world.executor.post(BusOverrun(bus.name)), lambda: None, Expected(codes(), (), 0.0)),
                ),
                ("frames come twice", Fault(late, bus.restore, Expected(codes(), (), 0.0))),
            ]
        )

    def _of_board(self) -> tuple[str, Fault] | None:
        world, timing, boards = self._world, self._world.arm.timing, self._world.boards
        board = self._random.choice(list(boards.simulated.names))
        silent = 1.2 * timing.heartbeat_timeout + timing.heartbeat + AT_ONCE
        lost = Expected(codes("board-lost"), (board,), silent, also=codes("interlock"), cleared=True)
        again = Expected(codes("board-rebooted"), (board,), 0.5, also=codes("interlock"))

        def reboot() -> None:
            boards.fault("power_cut", board)
            boards.fault("power_on", board)

        def emergency() -> None:
            boards.emergency(board, self._random.choice([0x2310, 0x3320, 0x8F00]))

        made = {
            "board is silent": Fault(
                lambda: boards.fault("silence", board), lambda: boards.fault("unsilence", board), lost
            ),
            "board without supply": Fault(
                lambda: boards.fault("power_cut", board),
                lambda: boards.fault("power_on", board),
                lost._replace(also=codes("interlock", "board-rebooted"), cleared=False),
            ),
            "board reboots": Fault(reboot, lambda: None, again),
            "emergency": Fault(emergency, lambda: None, Expected(codes("emergency"), (board,), AT_ONCE)),
        }
        return self._random.choice(list(made.items()))

    def _of_actuator(self) -> tuple[str, Fault] | None:
        world, boards = self._world, self._world.boards
        k = self._random.randrange(len(world.arm.actuators))
        channel = world.arm.wiring.channels[k]
        label, at = channel.actuator, boards.positions() >> k & 1
        seen = world.kinds.travel[k][1 - at] + 0.3
        if world.arm.wiring.interlocks and self._random.random() < 0.5:
            opened = Expected(codes("interlock"), ("door",), AT_ONCE)
            return "door is opened", Fault(
                lambda: boards.door("door", is_open=True), lambda: boards.door("door", is_open=False), opened
            )
        if not world.judge.arm.sensed >> k & 1 or world.executor.core is None:
            return None
        moved = Expected(codes("unexpected-motion"), (label,), seen)
        return "actuator moves by itself", Fault(
            lambda: boards.fault("stick", label, 1 - at), lambda: boards.fault("release", label), moved
        )

    def _foreign(self) -> tuple[str, Fault] | None:
        world = self._world
        channel = self._random.choice(world.arm.wiring.channels)
        frame, hurts = self._random.choice(
            [
                (Frame(cia301.NMT, bytes([Command.PRE_OPERATIONAL, channel.node])), True),
                (Frame(cia301.NMT, bytes([Command.START, 0])), False),
                (Frame(cia301.SYNC), False),
                (Frame(cia301.HEARTBEAT + 127, b"\x05"), False),
            ]
        )

        def send() -> None:
            if hurts:
                world.boards.hear_tool(channel.bus, frame)
            world.executor.post(FrameReceived(channel.bus, frame))

        also = codes("board-stopped", "interlock") if hurts else codes()
        expected = Expected(codes("foreign-master"), (channel.bus,), AT_ONCE, also=also)
        return f"foreign frame {frame.id:03X}h", Fault(send, lambda: None, expected)

    def _of_executor(self) -> tuple[str, Fault] | None:
        world, timing = self._world, self._world.arm.timing
        if self._random.random() < 0.5:
            short = (timing.heartbeat_timeout - timing.heartbeat) * 0.7
            expected = Expected(codes(), (), 0.0)
            return "executor stalls for a moment", Fault(lambda: world.executor.stall(short), lambda: None, expected)
        long = timing.heartbeat_timeout * self._random.choice([1.3, 3.0]) + self._random.choice([0.1, 1.0, 20.0])
        also = codes("interlock", "board-stopped", "emergency", "board-lost")
        expected = Expected(codes("halted"), ("executor",), long + AT_ONCE, also=also)
        return "executor stands still", Fault(lambda: world.executor.stall(long), lambda: None, expected)
