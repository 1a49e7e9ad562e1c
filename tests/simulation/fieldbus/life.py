"""The life of one arm's boards with a CANopen master, judged: boots, changes while no executor runs, and inputs."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from functools import partial
from random import Random
from typing import Any

from hyperbit.drivers.canopen.wire.cia301 import Frame
from hyperbit.drivers.canopen.wire.events import Event, FrameEchoed
from tests.simulation.agenda import Agenda
from tests.simulation.faults.fault import Deck, Fault, Told
from tests.simulation.fieldbus.arms import Drawn
from tests.simulation.fieldbus.boots import BootsAreSound
from tests.simulation.fieldbus.site import Site
from tests.simulation.fieldbus.statements import EVERY
from tests.simulation.statements.motions import Switch
from tests.simulation.statements.objects import BoardObjects
from tests.simulation.statements.pins import NoStartChangesAPin
from tests.simulation.statements.statement import Statements
from tests.simulation.verdict import Violation, require

LONGEST_BOOT = 25.0  # [s] with repeated requests
SPLIT = ("outputs in two RPDOs", "inputs in two TPDOs")  # each boot configures these anew, though nothing has changed
IN_FLIGHT = 0.003  # [s] until the last frames of an executor that has ended have left
SETTLED = 0.012  # [s] until inputs have come
SILENT = 0.05  # [s] that a board needs to notice the loss of the master, after its time-out
READS_INPUTS = b"\x00\x60"  # index of the inputs in an SDO frame


class Life(Site):
    """One arm, and the account of its pins and frames for the statements.

    pins(name, before, after, cause, of_command): pins of a board change; `switches` tells the same of all boards.
    sends(bus, frame), leaves(bus, frame, missing): the master hands out a frame; its echo comes.
    begins(), readies(): a time without trouble begins; all boards are ready.
    commands(), switched(changed): a command begins; it is over.
    knows(lost, why), tells(): some boards are lost, and this is told; all that is told must be true now.
    ticks(): the master was called.

    Attributes:
        ready: whether all boards are ready, and nothing disturbs them.
        calm: whether nothing disturbs the master.
        releases: whether pulses are ended at each tick.
        asked: pins after the last command, by board.
        released: mask of the lines that the last release switches off.
        moved_at: when pins of each board changed last [s].
        left: ends what is left on boards while no executor runs.
    """

    def __init__(
        self, drawn: Drawn, agenda: Agenda, random: Random, left: Deck, note: Callable[[object], None]
    ) -> None:
        self.note, self._pins, self.handed_out = note, dict[str, int](), 0
        super().__init__(drawn.wiring, drawn.timing, drawn.variants, agenda, random)
        self.drawn, self.random, self.made = drawn, random, Counter[str]()
        self.judged, self.looks, self.world = self.sight.wiring, self.sight.looks, self
        account: Any = self
        self.objects, self.boots = BoardObjects(account), BootsAreSound(self)
        self.statements = Statements(
            [self.objects, self.boots, NoStartChangesAPin(account), *(statement(self) for statement in EVERY)]
        )
        self.left: list[Callable[[], object]] = []
        self.calm = self.ready = self.releases = False
        self._deck = left
        self._undo: Callable[[], None] | None = None  # the change of an input
        self._pins = {name: look.pins() for name, look in self.looks.items()}
        self.asked, self.released, self.moved_at = dict(self._pins), 0, dict.fromkeys(self._pins, 0.0)

    def see(self, kind: str, *facts: object) -> None:
        self.statements.see(kind, facts)

    def driven(self) -> int:
        """Returns the mask of the output lines that are on."""
        return sum(board.driven(self.looks[name].pins()) for name, board in self.judged.boards.items())

    def ends(self) -> int:
        """Returns the mask of the input lines that are 1."""
        return sum(board.read(self.looks[name].inputs()) for name, board in self.judged.boards.items())

    # --- boots

    def boot(self, new: bool) -> None:
        """Boots all boards without trouble, and judges it."""
        self.start_boot(new)
        self.finish_boot()

    def start_boot(self, new: bool) -> None:
        """Begins a boot, by a new master if `new`. Takes the boards as they are."""
        new = new or self.running is None
        if new:
            self.running, self.calm = None, False
            self.boots.failed = set()
            for bus in self.buses.values():
                bus.drop()
            self.pass_time(IN_FLIGHT)
            if any(self.sight.guarded(name) for name in self.looks):  # else they fall in the middle of the boot
                self.lose_master(0.0)
        self.undo_flip()
        found = {name: self.sight.found(name, not new) for name in self.looks}
        self.note(("boot", new, {name: (one.state, one.errors) for name, one in found.items()}))
        self.calm, self.ready = True, False
        self.ask_for_nothing()
        self.see("begins")
        self.boots.begin(found)
        if new:
            self.start_master()
        self.call(lambda m: m.boot(self.now))
        if new:
            self.tick()

    def start_trouble_boot(self) -> None:
        """Begins a boot that nobody judges but for pins. An executor that stands still goes on with its command."""
        if not self.stalled and self.running is not None:
            self.ask_for_nothing()
            self.call(lambda m: m.boot(self.now))

    def ask_for_nothing(self) -> None:
        """The last command has ended, or was given up: from now on its states are no cause of a switch."""
        self.stage, self.asked = False, dict(self._pins)

    def at_rest(self) -> bool:
        """Whether an executor runs, and no boot is under way."""
        return self.running is not None and not self.stalled and not self.master.booting.under_way

    def finish_boot(self) -> None:
        self.wait(lambda: not self.master.booting.under_way, LONGEST_BOOT, "booted")
        master, faults = self.master, self.master.booting.faults
        self.made["boot: refused" if faults else "boot: ready"] += 1
        for fault in faults:
            self.made[f"boot: {fault.code}"] += 1
        self.boots.end(faults, list(master.warnings()), master.outputs_known)
        master.outputs.drain_missed()  # of pulses that trouble has ended
        late = master.faults.drain()
        require(not late, f"faults are told twice: {late}")
        self.calm = self.ready = master.outputs_known
        if self.ready:
            self.see("readies")
            split = {name for name, variant in self.drawn.names.items() if variant in SPLIT}
            self.boots.left = {name: self.sight.found(name).values for name in self.looks.keys() - split}
            self.settle()

    def die(self) -> None:
        """The executor ends; perhaps the boards notice."""
        self.running, self.calm, self.ready = None, False, False
        if self.random.random() < 0.5:
            self.lose_master(SILENT)

    def lose_master(self, more: float) -> None:
        self.pass_time(1.3 * self.timing.heartbeat_timeout + self.timing.heartbeat + more)

    def change(self, share: float = 0.6) -> None:
        """Leaves something on boards while no executor runs."""
        for _ in self.looks:
            if self.random.random() < share and (drawn := self._deck.draw(self, alone=False)) is not None:
                row, fault = drawn
                self.made[f"left: {row.name}"] += 1
                self.note(f"left: {row.name}")
                fault.begin()
                self.left.append(fault.end)

    def repair(self) -> None:
        """Ends all that was left, and cuts the supply of all boards for a moment."""
        self.mend()
        for end in reversed(self.left):
            end()
        self.left.clear()
        for verb in ("power_cut", "power_on"):
            for name in self.looks:
                self.boards.fault(verb, name)
            self.pass_time(0.02)

    def mend(self) -> None:
        """Ends faults of buses, and connects all boards."""
        for bus in self.buses.values():
            bus.restore()
        self.boards.loses = None
        for name in self.boards.simulated.names:
            self.boards.fault("unsilence", name)
            if not self.board(name).powered:
                self.boards.fault("power_on", name)

    # --- inputs

    def settle(self) -> None:
        """Waits until inputs have come, and judges what is told."""
        self.pass_time(SETTLED)
        self.see("tells")
        self.undo_flip()

    def flip_of(self, name: str) -> Fault | None:
        """Returns the opening of a door, or broken wires of an end-stop."""
        flips = [("open", "close", lock.name) for lock in self.wiring.interlocks if f"{lock.bus}/{lock.node}" == name]
        for channel in self.wiring.channels:
            board = channel.input_board or channel
            if channel.input is not None and f"{board.bus}/{board.node}" == name:
                flips.append((self.random.choice(["cut_wires", "short_wires"]), "restore_sensor", channel.actuator))
        if not flips or self.board(name).variant.pads:  # padding is warned of as the TPDO comes
            return None
        verb, undo, label = self.random.choice(flips)
        do = partial(self.boards.fault, verb, label), partial(self.boards.fault, undo, label)
        return Fault(*do, Told(within=0.1 + self.sight.slack), self._judge_inputs)

    def _judge_inputs(self) -> None:
        told, ends = self.master.inputs.ends, self.ends()
        require(told == ends, f"inputs {told:b} are told; they are {ends:b}")

    def flip_input(self, name: str) -> None:
        """Changes an input of a board within a moment, until `undo_flip`."""
        if self._undo is None and (flip := self.flip_of(name)) is not None:
            self._undo = flip.end
            self.agenda.after(self.random.uniform(0.0, 0.0006), flip.begin)

    def undo_flip(self) -> None:
        if self._undo is not None:
            self._undo()
            self._undo = None
            self.pass_time(SETTLED)

    # --- all frames and pins

    def hands_out(self, bus: str, frame: Frame) -> None:
        self.note(("master", bus, hex(frame.id), frame.data.hex()))
        self.handed_out += 1
        self.see("sends", bus, frame)
        asks = frame.id & ~0x7F == 0x600 and frame.data[1:3] == READS_INPUTS
        if asks and self.calm and self.master.booting.under_way and self.random.random() < 0.5:
            self.flip_input(f"{bus}/{frame.id & 0x7F}")

    def to_master(self, event: Event) -> None:
        if isinstance(event, FrameEchoed):
            self.see("leaves", event.bus, event.frame, 0)
        super().to_master(event)

    def from_board(self, bus: str, frame: Frame) -> None:
        self.note(("board", bus, hex(frame.id), frame.data.hex()))
        super().from_board(bus, frame)

    def tick(self) -> None:
        if self.releases and self.running is not None:
            self._release()
        super().tick()
        if self.calm and self.running is not None:
            self.see("ticks")

    def _release(self) -> None:
        """Ends pulses, as an executor does at each tick, also while boards boot."""
        possible = self.master.outputs.commanded | self.master.outputs.doubtful
        self.stage = self.stage and self.master.switching.under_way
        if possible & self.judged.pulsed and not self.stage:
            self.release(self.judged.pulsed)

    def commit(self, states: int) -> None:
        self.asked = {name: board.levels_of(states) for name, board in self.judged.boards.items()}
        super().commit(states)

    def release(self, off: int) -> None:
        self.released = off & self.judged.lines
        super().release(off)

    def sees(self, cause: str, belongs_to: object) -> None:
        for name, look in self.looks.items() if self._pins and cause != "read" else ():
            before, after = self._pins[name], look.pins()
            if before != after:
                self._pins[name], self.moved_at[name] = after, self.now
                self.note((name, f"pins {before:b} -> {after:b}", cause))
                self.see("pins", name, before, after, cause, belongs_to is True)
                self.see("switches", Switch(before ^ after, after, cause, name, None))

    def wait(self, holds: Callable[[], object], longest: float, text: str) -> None:
        """Runs steps until something holds."""
        until = self.now + longest
        while not holds():
            if self.now > until:
                raise Violation(f"it is not {text} after {longest:g} s")
            self.agenda.step()
