"""A world of boards and a CANopen master: boots, switches and single faults of boards, drawn from one seed."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable
from functools import partial
from random import Random

from hyperbit.drivers.canopen.run.master import Master
from hyperbit.drivers.canopen.wire.cia301 import Frame, State
from tests.simulation.agenda import Agenda
from tests.simulation.fieldbus import changes
from tests.simulation.fieldbus.arms import draw
from tests.simulation.fieldbus.faults import Faults
from tests.simulation.fieldbus.found import found_of
from tests.simulation.fieldbus.interruptions import Interruptions
from tests.simulation.fieldbus.site import READS_INPUTS, Site
from tests.simulation.fieldbus.use import Use
from tests.simulation.judge.fieldbus.boots import Boots
from tests.simulation.judge.fieldbus.outcomes import Found, Outcome
from tests.simulation.judge.fieldbus.switching import SYNC, Switching
from tests.simulation.judge.fieldbus.watching import Watching
from tests.simulation.judge.fieldbus.wires import JudgedWiring, Look
from tests.simulation.judge.verdict import Violation, require

MOST_REFUSALS = 2  # boots of one arm that end without all boards
LONGEST_BOOT = 20.0  # [s]
SPLIT = ("outputs in two RPDOs", "inputs in two TPDOs")  # each boot configures these anew, though nothing has changed
IN_FLIGHT = 0.003  # [s] until the last frames of an executor that has ended have left
TOLD = 0.012  # [s] until inputs have come
SILENT = 0.05  # [s] that a board needs to notice the loss of the master, after its time-out


class BoardWorld:
    """Arms one after another, each with some boots."""

    def __init__(self, seed: int, remembered: int = 300) -> None:
        self.random = Random(f"{seed} boards")
        self.agenda = Agenda()
        self.events: deque[tuple[float, object]] = deque(maxlen=remembered)
        self.made: Counter[str] = Counter()
        self._arrive()

    def run(self, steps: int) -> None:
        end = self.agenda.steps + steps
        while self.agenda.steps < end:
            self._live()
            self.agenda.clear()
            self._arrive()

    def _arrive(self) -> None:
        self.drawn = draw(self.random)
        self.note(f"boards {self.drawn.names}")
        self.site = site = Site(self.drawn, self.agenda, self.random)
        self.wiring = JudgedWiring(self.drawn.wiring, self.drawn.timing)
        self.looks = {name: self._look(name) for name in self.wiring.boards}
        self.boots, self.switching = Boots(self.wiring, self.looks), Switching(self.wiring, self.looks)
        self.boots.left = {}
        self._undo: Callable[[], None] | None = None  # the change of an input
        self.watching = Watching(self.wiring, self.looks)
        variants = self.drawn.variants.items()
        self.watching.standing = frozenset(name for name, variant in variants if variant.keeps_loss)
        self.watching.slow = frozenset(name for name, variant in variants if variant.answer_delay)
        self.watching.slack = 8 * max(variant.answer_delay for variant in self.drawn.variants.values())
        self.faults, self.interruptions, self.use = Faults(self), Interruptions(self), Use(self)
        self.calm = self.ready = False
        self.found: dict[str, Found] = {}
        site.hands_out, site.hears, site.ticked = self._hands_out, self._hears, self._ticked
        self._pins = {name: look.pins() for name, look in self.looks.items()}
        site.boards.watch = self._watch
        site.echoes = self.switching.echoes

    def _look(self, name: str) -> Look:
        board = self.site.board(name)
        return Look(
            lambda index, sub: (
                board.objects.number(index, sub)
                if board.objects.has(index) and sub in board.objects.described[index]
                else 0
            ),
            board.objects.has,
            lambda: None if board.state is None else int(board.state),
            lambda: board.pins,
            lambda: board.inputs,
        )

    def _live(self) -> None:
        """Boots the boards of one arm some times, and uses them."""
        random, refusals = self.random, 0
        self.pass_time(random.choice([0.02, 0.02, 0.4]))
        if random.random() < 0.3:
            self.change()
        self.boot(new=True)
        for _ in range(random.choice([2, 3, 4])):
            if not self.ready:
                refusals += 1
                if refusals == MOST_REFUSALS:
                    return
                changes.mend(self)
                self.boot(new=random.random() < 0.7)
                continue
            self.use.happen()
            for _ in range(random.choice([1, 2, 3, 4])):
                if self.ready:
                    self.faults.happen()
            drawn = random.random()
            if not self.ready:
                continue
            if drawn < 0.15:
                self.made["boot: at once"] += 1
                self.boot(new=random.random() < 0.5)
            elif drawn < 0.5:
                self._after_death(random)
                self.change()
                if random.random() < 0.3:  # perhaps the boards notice only now
                    self.pass_time(1.3 * self.drawn.timing.heartbeat_timeout + SILENT)
                self.boot(new=True)
            elif drawn < 0.75:
                self.interruptions.happen()
            elif drawn < 0.8:
                self.use.read_all()

    def _after_death(self, random: Random) -> None:
        """The executor ends; perhaps the boards notice."""
        self.site.master, self.calm, self.ready = None, False, False
        timing = self.drawn.timing
        if random.random() < 0.5:
            self.pass_time(1.3 * timing.heartbeat_timeout + timing.heartbeat + SILENT)

    def change(self) -> None:
        for name in self.looks:
            if self.random.random() < 0.6:
                changes.happen(self, name)

    def boot(self, new: bool) -> None:
        """Boots all boards without trouble, and judges it."""
        new = self.prepare(new)
        self.start_boot(new)
        began, master = self.agenda.now, self.master
        self.wait(lambda: not master.booting, LONGEST_BOOT, "booted")
        self.judge_boot(master, self.agenda.now - began)

    def prepare(self, new: bool) -> bool:
        """Ends the master if another one boots the boards; returns whether it does. Takes the boards as they are."""
        site = self.site
        new = new or site.master is None
        if new:
            site.master, self.calm = None, False
            self.boots.failed = set()
            for model in site.buses.values():
                model.drop()
            self.pass_time(IN_FLIGHT)
            if any(self.watching.guarded(name) for name in self.looks):  # else they fall in the middle of the boot
                self.pass_time(1.3 * self.drawn.timing.heartbeat_timeout + self.drawn.timing.heartbeat)
        self.undo_flips()
        self.found = {name: found_of(site.board(name), self.wiring.boards[name], not new) for name in self.looks}
        self.note(("boot", new, {name: (f.state, f.errors) for name, f in self.found.items()}))
        self.calm, self.ready = True, False
        self.watching.restart(self.agenda.now)
        self.boots.allowance = self._slowness()
        self.boots.begin(self.found)
        return new

    def start_boot(self, new: bool) -> None:
        if new:
            self.site.start_master()
        self.site.call(lambda m: m.boot(self.agenda.now))
        if new:
            self.site.call(lambda m: m.tick(self.agenda.now))

    def judge_boot(self, master: Master, seconds: float) -> dict[str, Outcome]:
        outcomes = self.boots.end(
            master.boot_faults, list(master.warnings()), master.outputs_known, seconds, self.drawn.timing
        )
        self.made["boot: refused" if master.boot_faults else "boot: ready"] += 1
        for fault in master.boot_faults:
            self.made[f"boot: {fault.code} {fault.message.split(' ', 2)[2][:50]}"] += 1
        master.drain_missed()  # of pulses that trouble has ended
        late = master.drain_faults()
        require(not late, f"faults are told twice: {late}")
        self.calm = self.ready = master.outputs_known
        if master.outputs_known:
            self.switching.booted()
            self.watching.ready(self.agenda.now)
            split = {name for name, variant in self.drawn.names.items() if variant in SPLIT}
            self.boots.left = {
                name: found_of(self.site.board(name), self.wiring.boards[name]).values
                for name in self.looks.keys() - split
            }
            self.settle()
        return outcomes

    def settle(self) -> None:
        """Waits until inputs have come, and judges what is told."""
        master = self.master
        self.pass_time(TOLD)
        self.watching.judge_told(master, self.switching.states)
        self.undo_flips()

    def flip_input(self, name: str) -> bool:
        """Opens a door or breaks an end-stop of a board within a moment; returns whether it has one."""
        wiring, boards = self.drawn.wiring, self.site.boards
        flips = [("open", "close", lock.name) for lock in wiring.interlocks if f"{lock.bus}/{lock.node}" == name]
        for channel in wiring.channels:
            board = channel.input_board or channel
            if channel.input is not None and f"{board.bus}/{board.node}" == name:
                flips.append((self.random.choice(["cut_wires", "short_wires"]), "restore_sensor", channel.actuator))
        if not flips or self._undo or self.site.board(name).variant.pads:  # padding is warned of as the TPDO comes
            return False
        verb, undo, label = self.random.choice(flips)
        self._undo = partial(boards.fault, undo, label)
        self.agenda.after(self.random.uniform(0.0, 0.0006), lambda: boards.fault(verb, label))
        return True

    def undo_flips(self) -> None:
        if self._undo is not None:
            self._undo()
            self._undo = None
            self.pass_time(TOLD)

    @property
    def master(self) -> Master:
        assert self.site.master is not None
        return self.site.master

    def _slowness(self) -> float:
        slow = 0.0
        for name, found in self.found.items():
            board = self.site.board(name)
            slow += 160 * board.variant.answer_delay
            slow += 0.5 * bool(found.errors) + 0.7 * (found.state in (None, State.STOPPED))
            slow += min(2 * found.byte(0x1017, 0) / 1000, 1.0)
            slow += 0.7 if board.state is None else 0.0
            slow += 2 * self.drawn.timing.heartbeat * (found.state != State.OPERATIONAL)
        return slow

    def pass_time(self, seconds: float) -> None:
        until = self.agenda.now + seconds
        while self.agenda.now < until:
            self.agenda.step()

    def wait(self, holds: Callable[[], object], longest: float, text: str) -> None:
        """Runs steps until something holds."""
        until = self.agenda.now + longest
        while not holds():
            if self.agenda.now > until:
                raise Violation(f"it is not {text} after {longest:g} s")
            self.agenda.step()

    def _hands_out(self, bus: str, frame: Frame) -> None:
        self.note(("master", bus, hex(frame.id), frame.data.hex()))
        if not self.calm:
            return
        self.watching.hands_out(bus, frame.id, frame.data, self.agenda.now)
        if self.boots.running:
            self.boots.hands_out(bus, frame.id, frame.data)
            if frame.id & ~0x7F == 0x600 and frame.data[1:3] == READS_INPUTS and self.random.random() < 0.5:
                self.flip_input(f"{bus}/{frame.id & 0x7F}")
        elif self.ready and (frame.id == SYNC or 0x200 <= frame.id < 0x580):
            self.switching.hands_out(bus, frame.id, frame.data)
        elif self.ready:
            sdo, alive = frame.id & ~0x7F == 0x600, frame.id == 0x77F or frame.id >> 30
            require(sdo or alive, f"{bus}: frame {frame.id:03X}h while all boards are ready")

    def _hears(self, bus: str, frame: Frame) -> None:
        self.note(("board", bus, hex(frame.id), frame.data.hex()))

    def _ticked(self) -> None:
        if self.calm:
            self.watching.tick(self.agenda.now)

    def _watch(self, cause: str) -> None:
        if cause == "read":
            return
        for name, look in self.looks.items():
            before, after = self._pins[name], look.pins()
            if before == after:
                continue
            self._pins[name] = after
            self.note((name, f"pins {before:b} -> {after:b}", cause))
            board = self.wiring.boards[name]
            if cause in ("START", "frame"):
                require(False, f"{name}: pins {before:b} become {after:b} by {cause}")
            rises = after & ~before & ~board.off
            if cause in ("SDO", "NMT"):
                require(not rises, f"{name}: pins {rises:b} come on by {cause}")
            if self.ready and self.calm:
                require(cause in ("SYNC", "RPDO"), f"{name}: pins {before:b} become {after:b} by {cause}")
            if cause in ("SYNC", "RPDO") and self.calm:
                changed = before ^ after
                require(not changed & ~board.used, f"{name}: pins {changed:b} are switched; {board.used:b} are used")

    @property
    def arm(self) -> object:
        return self.drawn

    def counts(self) -> Counter[str]:
        return Counter({f"fieldbus: {what}": count for what, count in self.made.items()})

    def note(self, event: object) -> None:
        self.events.append((self.agenda.now, event))

    def story(self) -> str:
        return "\n".join(f"{time - 1000:.6f} {event}" for time, event in self.events)
