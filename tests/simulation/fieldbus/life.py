"""The life of one arm's boards with a CANopen master, judged: boots, changes while no executor runs, and inputs."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from functools import partial
from random import Random

from hyperbit.drivers.canopen.wire.cia301 import Frame, State
from hyperbit.drivers.canopen.wire.events import Event, FrameEchoed
from tests.simulation.agenda import Agenda
from tests.simulation.faults.fault import Deck, Fault, Told
from tests.simulation.faults.left import BUSY_FOR
from tests.simulation.fieldbus.arms import Drawn
from tests.simulation.fieldbus.judge.boots import Boots
from tests.simulation.fieldbus.judge.outcomes import Found
from tests.simulation.fieldbus.judge.switching import SYNC, Switching
from tests.simulation.fieldbus.site import TOOL, Site
from tests.simulation.verdict import Violation, require

LONGEST_BOOT = 25.0  # [s] with repeated requests
SPLIT = ("outputs in two RPDOs", "inputs in two TPDOs")  # each boot configures these anew, though nothing has changed
IN_FLIGHT = 0.003  # [s] until the last frames of an executor that has ended have left
SETTLED = 0.012  # [s] until inputs have come
SILENT = 0.05  # [s] that a board needs to notice the loss of the master, after its time-out
READS_INPUTS = b"\x00\x60"  # index of the inputs in an SDO frame


class Life(Site):
    """One arm.

    Attributes:
        ready: whether all boards are ready, and nothing disturbs them.
        calm: whether the master's heartbeats and reads must be in time.
        found: the boards as the last boot found them.
        left: ends what is left on boards while no executor runs.
    """

    def __init__(
        self, drawn: Drawn, agenda: Agenda, random: Random, left: Deck, note: Callable[[object], None]
    ) -> None:
        self.note, self._pins, self.handed_out = note, dict[str, int](), 0
        super().__init__(drawn.wiring, drawn.timing, drawn.variants, agenda, random)
        self.drawn, self.random, self.made = drawn, random, Counter[str]()
        self.judged, self.looks, self.watching = self.sight.wiring, self.sight.looks, self.sight.watching
        self.boots, self.switching = Boots(self.judged, self.looks), Switching(self.judged, self.looks)
        self.found: dict[str, Found] = {}
        self.left: list[Callable[[], object]] = []
        self.calm = self.ready = self.releases = False
        self._deck = left
        self._undo: Callable[[], None] | None = None  # the change of an input
        self._pins = {name: look.pins() for name, look in self.looks.items()}
        self._asked = dict(self._pins)  # pins after the last command
        self._released = 0  # mask of the lines that the last release switches off

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
            if any(self.watching.guarded(name) for name in self.looks):  # else they fall in the middle of the boot
                self.lose_master(0.0)
        self.undo_flip()
        self.found = {name: self.sight.found(name, not new) for name in self.looks}
        self.note(("boot", new, {name: (found.state, found.errors) for name, found in self.found.items()}))
        self.calm, self.ready, self.stage = True, False, False
        self.watching.restart(self.now)
        self.boots.allowance = sum(self._slowness(name, found) for name, found in self.found.items())
        self.boots.begin(self.found)
        self._began, self._asked = self.now, dict(self._pins)
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
        self.stage, self._asked = False, dict(self._pins)

    def at_rest(self) -> bool:
        """Whether an executor runs, and no boot is under way."""
        return self.running is not None and not self.stalled and not self.master.booting

    def finish_boot(self) -> None:
        self.wait(lambda: not self.master.booting, LONGEST_BOOT, "booted")
        master = self.master
        faults, warnings = master.boot_faults, list(master.warnings())
        self.boots.end(faults, warnings, master.outputs_known, self.now - self._began, self.timing)
        self.boots.repeats = 0
        self.made["boot: refused" if faults else "boot: ready"] += 1
        for fault in faults:
            self.made[f"boot: {fault.code} {fault.message.split(' ', 2)[2][:50]}"] += 1
        master.drain_missed()  # of pulses that trouble has ended
        late = master.drain_faults()
        require(not late, f"faults are told twice: {late}")
        self.calm = self.ready = master.outputs_known
        if self.ready:
            self.switching.booted()
            self.watching.ready(self.now)
            split = {name for name, variant in self.drawn.names.items() if variant in SPLIT}
            self.boots.left = {name: self.sight.found(name).values for name in self.looks.keys() - split}
            self.settle()

    def _slowness(self, name: str, found: Found) -> float:
        """Returns how much longer a boot may take [s]."""
        variant, state = self.board(name).variant, self.board(name).state
        slow = 160 * variant.answer_delay + min(2 * found.byte(0x1017, 0) / 1000, 1.0) + 0.7 * (state is None)
        slow += 0.5 * bool(found.errors) + 0.7 * (found.state in (None, State.STOPPED))
        busy = bool(self.board(name).objects.refused) and not found.refused
        return slow + 2 * self.timing.heartbeat * (found.state != State.OPERATIONAL) + busy * (BUSY_FOR + 0.2)

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

    # --- inputs

    def settle(self) -> None:
        """Waits until inputs have come, and judges what is told."""
        self.pass_time(SETTLED)
        self.watching.now = self.now
        self.watching.judge_told(self.master, self.switching.states)
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
        told = Told(within=0.1 + self.watching.slack)
        do = partial(self.boards.fault, verb, label), partial(self.boards.fault, undo, label)
        return Fault(*do, told, lambda: self._judge_inputs(name))

    def _judge_inputs(self, name: str) -> None:
        ends = sum(board.read(self.looks[other].inputs()) for other, board in self.judged.boards.items())
        require(self.master.ends == ends, f"inputs {self.master.ends:b} are told; they are {ends:b}")

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
        if not self.calm:
            return
        self.watching.hands_out(bus, frame.id, frame.data, self.now)
        if self.boots.running:
            self.boots.hands_out(bus, frame.id, frame.data)
            if frame.id & ~0x7F == 0x600 and frame.data[1:3] == READS_INPUTS and self.random.random() < 0.5:
                self.flip_input(f"{bus}/{frame.id & 0x7F}")
        elif self.ready and (frame.id == SYNC or 0x200 <= frame.id < 0x580):
            self.switching.hands_out(bus, frame.id, frame.data)
        elif self.ready:
            sdo, alive = frame.id & ~0x7F == 0x600, frame.id == 0x77F or frame.id >> 30
            require(sdo or alive, f"{bus}: frame {frame.id:03X}h while all boards are ready")

    def from_board(self, bus: str, frame: Frame) -> None:
        self.note(("board", bus, hex(frame.id), frame.data.hex()))
        super().from_board(bus, frame)

    def tick(self) -> None:
        if self.releases and self.running is not None:
            self._release()
        super().tick()
        if self.calm and self.running is not None:
            self.watching.tick(self.now)

    def _release(self) -> None:
        """Ends pulses, as an executor does at each tick, also while boards boot."""
        possible = self.master.outputs | self.master.doubtful
        self.stage = self.stage and self.master.committing
        if possible & self.judged.pulsed and not self.stage:
            self.commit(possible & ~self.judged.pulsed, release=True)

    def commit(self, states: int, release: bool = False) -> None:
        if release:
            self._released = ~states & self.judged.lines
        else:
            self._asked = {name: board.levels_of(states) for name, board in self.judged.boards.items()}
        super().commit(states, release)

    def sees(self, cause: str, belongs_to: object) -> None:
        if cause == "read" or not self._pins:
            return
        for name, look in self.looks.items():
            before, after = self._pins[name], look.pins()
            if before != after:
                self._pins[name] = after
                self.note((name, f"pins {before:b} -> {after:b}", cause))
                self._judge_pins(name, before, after, cause, belongs_to is True)

    def _judge_pins(self, name: str, before: int, after: int, cause: str, stage: bool) -> None:
        """Requires a cause: a command, the loss of the master, the supply, or another program."""
        board, changed, rises = self.judged.boards[name], before ^ after, after & ~before
        text = f"{name}: pins {before:b} become {after:b} by {cause}"
        if cause in ("START", "frame"):
            require(False, text)
        elif cause in ("SDO", "NMT"):
            require(not rises & ~board.off, text)
        elif cause in ("SYNC", "RPDO"):
            ends = sum(1 << wire.bit for wire in board.outputs if wire.line & self._released)
            late = (after ^ self._asked[name]) & board.used  # a board that has missed its command follows it now
            require(stage or not (changed & ~ends | rises & ends & ~board.off) & late, f"{text} of a release")
            require(not self.calm or not changed & ~board.used, f"{text}; {board.used:b} are used")
        require(not (self.ready and self.calm) or cause in ("SYNC", "RPDO"), text)
        on, came = after ^ board.off, changed & (after ^ board.off)
        pairs = [(a, b) for a, b in board.pairs if on >> a & on >> b & (came >> a | came >> b) & 1]
        require(not pairs or cause in (TOOL, "foreign", "fault"), f"{text}: one of {pairs} comes on beside the other")

    def to_master(self, event: Event) -> None:
        if isinstance(event, FrameEchoed):
            self.switching.echoes(event.bus, event.frame.id, self.now)
        super().to_master(event)

    def wait(self, holds: Callable[[], object], longest: float, text: str) -> None:
        """Runs steps until something holds."""
        until = self.now + longest
        while not holds():
            if self.now > until:
                raise Violation(f"it is not {text} after {longest:g} s")
            self.agenda.step()
