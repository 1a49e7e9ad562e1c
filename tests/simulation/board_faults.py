"""Single faults of boards that run: objects that cannot be read or change, errors, a second board, lost TPDOs."""

from __future__ import annotations

from collections.abc import Callable
from random import Random
from typing import TYPE_CHECKING, Any

from hyperbit.controller.executor.core.events import Health
from hyperbit.drivers.canopen.wire import cia301
from hyperbit.drivers.canopen.wire.cia301 import Frame
from hyperbit.drivers.canopen.wire.events import BusOverrun
from tests.simulation.judge.expected import Expected
from tests.simulation.judge.traffic import PACE, SHARE
from tests.simulation.planner import ScriptedPlanner

if TYPE_CHECKING:
    from tests.simulation.world import World

SHOWN = 0.1  # [s] until a warning is told, by the next snapshot
THREE_READS = 3.0  # [s] until outputs were read three times: each about a second after the one before
ASKED = 0.3  # [s] until the boards of a late actuator were asked
OBJECTS = 60  # of one board that are read in turn, at most
SLOWEST = 7.0  # [s], longest time of a turn through all objects that is worth waiting for
STORM = 25  # emergencies at once
HARDWARE_ERROR = 0x0606_0000
ALIEN = ((0x1019, 0, 10), (0x1007, 0, 10_000), (0x1029, 1, 1), (0x1014, 0, 0xEE), (0x6208, 1, 0), (0x1800, 5, 50))

Made = tuple[Callable[[], object], Callable[[], object], Expected]


class BoardFaults:
    def __init__(self, world: World, random: Random) -> None:
        self._world, self._random = world, random

    def draw(self) -> dict[str, Made]:
        world = self._world
        name = self._random.choice(list(world.boards.simulated.names))
        board = world.boards.simulated.board(name)
        made = self._of_process() | self._of_errors(name, board) | self._of_reads(name, board)
        return made | self._of_switch() | self._of_inputs()

    def _of_process(self) -> dict[str, Made]:
        post, loop = self._world.executor.post, {"worst": self._random.random()}
        dropped = self._random.randrange(100)
        text = "the disk is full"
        warned = Expected(frozenset({"journal"}), ("executor",), SHOWN, cleared=True, words=(text,))
        return {
            "journal is not written": (
                lambda: post(Health(loop, dropped, text)),
                lambda: post(Health(loop, dropped, None)),
                warned,
            )
        }

    def _of_errors(self, name: str, board: Any) -> dict[str, Made]:
        world, random = self._world, self._random
        running: list[bool] = []
        codes = [0x2310, 0x3320, 0x8F00, 0x5000]

        def storm() -> None:
            for _ in range(STORM):
                world.boards.emergency(name, random.choice(codes))

        def twice() -> None:
            bus, node = name.split("/")
            period = board.objects.number(0x1017, 0) / 1000
            running.append(True)

            def beat() -> None:
                if running:
                    world.buses[bus].from_other(Frame(cia301.HEARTBEAT + int(node), b"\x05"))
                    world.agenda.after(period, beat)

            beat()

        told = Expected(frozenset({"emergency"}), (name,), 0.1, words=("it reports",))
        second = Expected(
            frozenset({"duplicate-node"}), (name,), 35 * world.arm.timing.heartbeat + 0.2, words=("two boards",)
        )
        made: dict[str, Made] = {"emergencies in a storm": (storm, _nothing, told)}
        if board.objects.has(0x1016) and board.objects.number(0x1017, 0):
            made["two boards have one node id"] = (twice, running.clear, second)
        return made

    def _of_reads(self, name: str, board: Any) -> dict[str, Made]:
        """Returns changes that the reads in turn find."""
        objects, random = board.objects, self._random
        bus = name.split("/")[0]
        here = sum(other.startswith(f"{bus}/") for other in self._world.boards.simulated.names)
        rate = next(b.bitrate for b in self._world.arm.wiring.buses if b.name == bus)
        turn = OBJECTS * here * max(PACE, 270 / (SHARE * rate))
        if turn > SLOWEST:
            return {}
        index, sub, value = random.choice(ALIEN)
        entry = objects.described.get(index, {}).get(sub)
        before = 0 if entry is None else objects.number(index, sub)
        made: dict[str, Made] = {
            "error without an emergency": (
                lambda: objects.set_number(0x1001, 0, 0x80),
                lambda: objects.set_number(0x1001, 0, 0),
                Expected(frozenset({"board-error"}), (name,), turn, words=("1001h sub 0 is 80h",)),
            )
        }
        if entry is not None and entry.writable and before != value and index not in (0x6208, 0x1800):
            changed = Expected(frozenset({"board-changed"}), (name,), turn, words=(f"{index:04X}h sub {sub}",))
            made["another program writes"] = (
                lambda: objects.set_number(index, sub, value),
                lambda: objects.set_number(index, sub, before),
                changed,
            )
        return made

    def _of_switch(self) -> dict[str, Made]:
        world, random, planner = self._world, self._random, self._world.planner
        assert isinstance(planner, ScriptedPlanner)
        account, wiring = world.account, world.arm.wiring
        free = [k for k in range(len(wiring.channels)) if not account.locked >> k & 1]
        if not free or account.homing:
            return {}
        k = random.choice(free)
        channel = wiring.channels[k]
        name = f"{channel.bus}/{channel.node}"
        objects, place = world.boards.simulated.board(name).objects, (world.objects.base(name), 0)
        place = place[0], channel.output // 8 + 1

        def unread() -> None:
            objects.refused[place] = HARDWARE_ERROR
            planner.ask_to_switch(k)

        silent = Expected(
            frozenset({"not-verified"}),
            (name,),
            THREE_READS,
            words=(f"{place[0]:04X}h sub {place[1]}", "hardware error"),
        )
        unverified = any(not n.verify and (n.bus, n.node) == (channel.bus, channel.node) for n in wiring.nodes)
        if channel.pulse is not None or unverified:
            return {}
        return {"outputs cannot be read": (unread, objects.refused.clear, silent)}

    def _of_inputs(self) -> dict[str, Made]:
        """Returns an overrun after lost TPDOs: all inputs are read at once."""
        world, boards = self._world, self._world.boards
        k = self._random.randrange(len(world.arm.actuators))
        if not world.account.arm.sensed >> k & 1:
            return {}
        label, at = world.arm.actuators[k], boards.positions() >> k & 1
        bus = world.buses[world.arm.wiring.channels[k].bus]
        travel = world.kinds.travel[k][1 - at]

        def happen() -> None:
            bus.tpdos_to_lose = 99
            boards.fault("stick", label, 1 - at)
            world.agenda.after(travel, lambda: world.executor.post(BusOverrun(bus.name)))

        def mend() -> None:
            bus.tpdos_to_lose = 0
            boards.fault("release", label)

        moved = Expected(frozenset({"unexpected-motion"}), (label,), travel + ASKED)
        return {"overrun after lost TPDOs": (happen, mend, moved)}


def _nothing() -> None:
    """Mends a fault that is over at once."""
