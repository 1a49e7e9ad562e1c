"""Boots in which one thing goes wrong: lost and late frames, restarts, lost buses, other programs."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from hyperbit.drivers.canopen.wire import cia301
from hyperbit.drivers.canopen.wire.cia301 import Command, Frame, State
from hyperbit.drivers.canopen.wire.events import FrameReceived
from tests.simulation.fieldbus import changes
from tests.simulation.fieldbus.found import found_of
from tests.simulation.judge.verdict import require

if TYPE_CHECKING:
    from tests.simulation.fieldbus.world import BoardWorld

LONGEST = 25.0  # [s] of a boot with repeated requests
SDO_TIMEOUT = 0.5  # [s] of one request
MOST_RESTARTS = 5  # of one board in a boot
DEVICE_TYPE = b"\x00\x10"  # its index in an SDO frame


class Interruptions:
    """Draws what goes wrong in a boot."""

    def __init__(self, world: BoardWorld) -> None:
        self._world = world

    def happen(self) -> None:
        """Boots the boards with one interruption, and judges what becomes of them."""
        world, random = self._world, self._world.random
        self._name = random.choice(list(world.looks))
        self._board, self._judged = world.site.board(self._name), world.wiring.boards[self._name]
        self._place = random.choice([0, 1, 2, 3, random.randrange(40), random.randrange(100)])
        self._outputs_only = False
        if random.random() < 0.7:
            world.site.master, world.calm, world.ready = None, False, False
            changes.happen(world, self._name)
        kinds: list[Callable[[], None]] = [self._frames, self._frames, self._frames, self._restart, self._restarts]
        kinds += [self._restart_at_outputs] * 2
        kinds += [self._bus, self._command, self._start, self._reset, self._stall, self._error]
        kind = random.choice(kinds)
        world.made[f"boot with: {kind.__name__[1:]}"] += 1
        world.note(f"boot with {kind.__name__[1:]} of {self._name} at {self._place}")
        kind()
        self._end()

    def _end(self) -> None:
        world = self._world
        world.site.intercept = lambda bus, frame: ""
        for bus in world.site.buses.values():
            bus.restore()
        if not world.ready:
            world.ready = world.calm = False
            changes.mend(world)
            world.boot(new=True)

    def _begin(self) -> float:
        world = self._world
        world.prepare(new=True)
        world.start_boot(new=True)
        return world.agenda.now

    def _is_sdo(self, bus: str, frame: Frame) -> bool:
        return bus == self._judged.bus and frame.id in (0x600 + self._judged.node, 0x580 + self._judged.node)

    def _is_of_outputs(self, frame: Frame) -> bool:
        return int.from_bytes(frame.data[1:3], "little") == self._judged.base

    def _at_place(self, happen: Callable[[], str]) -> None:
        """Calls a function at the drawn SDO frame."""
        count = [0]

        def look(bus: str, frame: Frame) -> str:
            if not self._is_sdo(bus, frame) or (self._outputs_only and not self._is_of_outputs(frame)):
                return ""
            count[0] += 1
            master = self._world.site.master
            return happen() if count[0] == self._place + 1 and master is not None and master.booting else ""

        self._world.site.intercept = look

    def _frames(self) -> None:
        """One SDO frame is lost, late or doubled: the boot ends as without it, a time-out later."""
        world = self._world
        kind = world.random.choice(["lose", "lose", "late", "twice"])
        if self._board.state is not State.OPERATIONAL:
            self._place += 6  # a board that was stopped is asked once more only
        self._at_place(lambda: kind)
        began = self._begin()
        world.boots.allowance += SDO_TIMEOUT + 0.1
        world.boots.repeats = 2
        world.wait(lambda: not world.master.booting, LONGEST, "booted")
        world.judge_boot(world.master, world.agenda.now - began)
        world.boots.repeats = 0

    def _restart(self) -> None:
        """The board restarts: it boots anew."""
        world = self._world
        name = self._name

        def restart() -> str:
            world.agenda.after(1e-6, cut)
            return "lose"

        def cut() -> None:
            if not world.boots.running:
                return
            world.site.boards.fault("power_cut", name)
            world.site.boards.fault("power_on", name)
            world.found[name] = world.boots.found[name] = found_of(self._board, self._judged)
            world.boots.again(name)

        self._at_place(restart)
        began = self._begin()
        world.boots.allowance += 2.0 + self._board.variant.boot_time + LONGEST * bool(self._board.variant.answer_delay)
        world.boots.repeats = 3
        world.wait(lambda: not world.master.booting, LONGEST, "booted")
        world.judge_boot(world.master, world.agenda.now - began)
        world.boots.repeats = 0

    def _restart_at_outputs(self) -> None:
        """The board restarts at an SDO frame of its outputs."""
        self._outputs_only = True
        self._place = self._world.random.randrange(12)
        self._restart()

    def _restarts(self) -> None:
        """The board restarts again and again."""
        world, name = self._world, self._name
        if self._board.variant.boot_time or self._board.silent or not self._board.powered:
            return
        restarts = [0]

        def look(bus: str, frame: Frame) -> str:
            if self._is_sdo(bus, frame) and frame.data[1:4] == b"\x05\x10\x00" and frame.id >= 0x600:
                restarts[0] += 1
                world.agenda.after(1e-6, cut)
                return "lose"
            return ""

        def cut() -> None:
            world.site.boards.fault("power_cut", name)
            world.site.boards.fault("power_on", name)

        world.site.intercept = look
        self._begin()
        world.boots.running = False
        world.wait(lambda: not world.master.booting, LONGEST, "booted")
        ours = [fault for fault in world.master.boot_faults if fault.source == name]
        require(len(ours) == 1, f"{name} restarts again and again, told is {world.master.boot_faults}")
        if restarts[0]:
            words = f"restarted {MOST_RESTARTS + 1} times"
            right = ours[0].code == "board-rebooted" and words in ours[0].message and restarts[0] > MOST_RESTARTS
            require(right, f"{name} restarted {restarts[0]} times, told is {ours[0]}")
        require(not world.master.outputs_known, "the master is ready")

    def _bus(self) -> None:
        """A bus fails: its fault is told, and none of its boards."""
        world = self._world
        bus = world.site.buses[self._judged.bus]
        fail, code = world.random.choice([(bus.go_down, "bus-down"), (bus.go_off, "bus-off")])
        failed: list[bool] = []

        def happen() -> str:
            world.agenda.after(1e-6, lambda: (failed.append(True), fail()))
            return ""

        self._at_place(happen)
        self._begin()
        world.boots.running = world.calm = False
        world.wait(lambda: not world.master.booting, LONGEST, "booted")
        if not failed:
            return
        here = [f for f in world.master.boot_faults if f.source.split("/")[0] == bus.name]
        right = [(f.code, f.source) for f in here] == [(code, bus.name)]
        lost = world.master.outputs_known is False and not world.master.back
        require(right and lost, f"{bus.name} fails in a boot, told is {here}")

    def _command(self) -> None:
        """Another program sends an NMT command: the boot ends, and the next one is without fault."""
        world = self._world
        command = world.random.choice(
            [Command.STOP, Command.PRE_OPERATIONAL, Command.RESET_COMMUNICATION, Command.RESET_NODE]
        )

        def happen() -> str:
            world.agenda.after(1e-6, lambda: world.site.order(self._name, command))
            return ""

        self._at_place(happen)
        self._begin()
        world.boots.running = False
        world.wait(lambda: not world.master.booting, LONGEST, "booted")

    def _start(self) -> None:
        """The master hears that another program starts the board: its boot begins again."""
        world, name = self._world, self._name
        begun: list[int] = []

        def start() -> None:
            if world.site.master is None or not world.master.booting:
                return
            frame = Frame(cia301.NMT, bytes([Command.START, self._judged.node]))
            world.site.boards.receive(self._judged.bus, frame, "foreign START")
            begun.append(0)
            world.site.tell(FrameReceived(self._judged.bus, frame, world.agenda.now))
            world.site.intercept = look

        def look(bus: str, frame: Frame) -> str:
            asks = bus == self._judged.bus and frame.id == 0x600 + self._judged.node
            begun[0] += asks and frame.data[1:3] == DEVICE_TYPE
            return ""

        self._at_place(lambda: str(world.agenda.after(1e-6, start) or ""))
        self._begin()
        world.boots.running = False
        world.wait(lambda: not world.master.booting, LONGEST, "booted")
        require(all(begun), f"{name} was started by another program in its boot, and does not boot again")

    def _error(self) -> None:
        """The board reports an error: it is refused, and the sentence has the code of the error."""
        world = self._world
        code = world.random.choice([0x2310, 0x5000, 0x4200])
        begun: list[bool] = []

        def happen() -> str:
            begun.append(True)
            self._board.emergencies.report(code)
            return ""

        self._place = world.random.randrange(3, 30)
        self._at_place(happen)
        self._begin()
        world.boots.running = False
        world.wait(lambda: not world.master.booting, LONGEST, "booted")
        ours = [fault for fault in world.master.boot_faults if fault.source == self._name]
        require(bool(ours) or not begun, f"{self._name} has reported an error in its boot, and is not refused")
        if begun and ours[0].code == "board-error":
            words = [f"({code:04X}h)", "1001h sub 0 is"]
            require(all(word in ours[0].message for word in words), f"{ours[0]} is told; its sentence has {words}")

    def _reset(self) -> None:
        """The boot begins again."""
        world = self._world
        over: list[bool] = []

        def happen() -> str:
            world.agenda.after(1e-6, lambda: over.append(True))
            return ""

        self._at_place(happen)
        self._begin()
        world.wait(lambda: over or not world.master.booting, LONGEST, "booted")
        world.boots.running = False
        world.site.intercept = lambda bus, frame: ""
        world.boot(new=False)

    def _stall(self) -> None:
        """The executor stands still: the boot begins again by itself."""
        world, timing = self._world, self._world.drawn.timing
        over: list[bool] = []

        def happen() -> str:
            world.site.stalled = True
            world.agenda.after(1.5 * timing.heartbeat_timeout, lambda: over.append(True))
            return ""

        self._at_place(happen)
        self._begin()
        world.boots.running = world.calm = False
        world.wait(lambda: over or not (world.master.booting or world.site.stalled), LONGEST, "booted")
        if not over:
            return
        begins = world.master.booting
        found = world.master.find_pause(world.agenda.now)
        require((found is None) == begins, f"a pause in a boot is told as {found}")
        require(world.master.booting == begins, "a boot has ended by a pause")
        world.site.go_on()
        world.wait(lambda: not world.master.booting, LONGEST, "booted")
