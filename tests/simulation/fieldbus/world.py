"""A world of boards and a CANopen master: arms one after another, with short lives full of faults, from one seed."""

from __future__ import annotations

import math
from collections import Counter, deque
from random import Random
from typing import Any

from hyperbit.drivers.canopen.wire.cia301 import State
from tests.simulation.agenda import Agenda, StepsAreOver
from tests.simulation.faults.fault import Deck, Fault, Row, Told
from tests.simulation.faults.table import rows
from tests.simulation.fieldbus import commands
from tests.simulation.fieldbus.arms import draw
from tests.simulation.fieldbus.life import LONGEST_BOOT
from tests.simulation.fieldbus.mid_boot import disturb_boot
from tests.simulation.fieldbus.use import UsedArm
from tests.simulation.verdict import require

MOST_REFUSALS = 2  # boots of one arm that end without all boards
KEPT = 0.25  # [s] for which nothing else may be told
PROBES, BACK = 0.5, 3.0  # [s] between two questions to lost boards; until a mended board is heard
ROUNDS = (
    ("fault",) * 8 + ("command",) * 5 + ("boot at once", "next executor") + ("use", "disturbed boot", "trouble") * 2
)
ALONE = ("bus", "board", "executor")


class BoardWorld:
    """Arms one after another, each with some boots.

    Args:
        only: the one fault that strikes its arms; None: all of the table.
    """

    def __init__(self, seed: int, remembered: int = 300, only: Row | None = None) -> None:
        self.random = Random(f"{seed} boards")
        self.agenda = Agenda()
        self.events: deque[tuple[float, object]] = deque(maxlen=remembered)
        self._made: Counter[str] = Counter()
        alone, left, self._rounds = rows(*ALONE), rows("left"), ROUNDS
        if only is not None and only.strikes == "left":
            left, self._rounds = [only], ("next executor", "use")
        elif only is not None:
            alone, self._rounds = [only], ("fault",)
        self._alone = Deck(alone, self.random, seed)
        self._commands = Deck(commands.ROWS, self.random, seed)
        self._beside = Deck([row for row in alone if row.anytime], self.random, seed)
        self._left = Deck(left, self.random, seed)
        self._arrive()

    def run(self, steps: int) -> None:
        """Runs `steps` steps."""
        self.agenda.end = self.agenda.steps + steps
        try:
            while True:
                self._live()
                self._made = self.counted()
                self.agenda.clear()
                self._arrive()
        except StepsAreOver:
            self.agenda.end = math.inf

    def _arrive(self) -> None:
        drawn = draw(self.random)
        self.note(f"boards {drawn.names}")
        self.arm = UsedArm(drawn, self.agenda, self.random, self._left, self.note)

    def _live(self) -> None:
        """Boots the boards of one arm, uses them, and causes faults."""
        arm, random, refusals = self.arm, self.random, 0
        arm.pass_time(random.choice([0.02, 0.02, 0.4]))
        if random.random() < 0.3:
            arm.change()
        arm.boot(new=True)
        for _ in range(random.choice([3, 6, 9])):
            if arm.ready:
                self._round(random.choice(self._rounds))
            elif refusals + 1 < MOST_REFUSALS:
                refusals += 1
                arm.repair()
                arm.boot(new=random.random() < 0.7)

    def _round(self, kind: str) -> None:
        arm = self.arm
        arm.made[kind] += 1
        match kind:
            case "fault":
                if self.random.random() < 0.5:
                    arm.use()
                self._fault(self._alone)
            case "command":
                self._fault(self._commands)
            case "use":
                arm.use()
            case "boot at once":
                arm.boot(new=self.random.random() < 0.5)
            case "next executor":
                self._change_executor(0.5)
                arm.boot(new=True)
            case "disturbed boot":
                disturb_boot(arm, self._beside)
            case "trouble":
                self._trouble()

    def _change_executor(self, late: float) -> None:
        """The executor ends, and something is left on boards; `late`: share of the boards that notice only now."""
        self.arm.die()
        self.arm.change()
        if self.random.random() < late:
            self.arm.lose_master(0.0)

    # --- faults

    def _fault(self, deck: Deck) -> None:
        """Causes one fault of a deck, judges what is told, ends it, and boots the boards again."""
        drawn = deck.draw(self.arm, alone=True)
        if drawn is None:
            return
        (row, fault), arm = drawn, self.arm
        told = fault.told
        assert told is not None
        self.note(f"fault: {row.name}")
        arm.ready, arm.calm, began = False, told.beats, arm.now
        fault.begin()
        arm.boards.see("foreign")
        heard: list[Any] = []
        if told.codes:
            due = began + told.within - arm.now
            arm.wait(lambda: self._hear(row, told, heard, began), due, f"told: {row.name}, {told}")
        else:
            arm.pass_time(told.within)
            self._hear(row, told, heard, began)
        if not told.also:
            arm.see("knows", told.lost, row.name)
            require(not (told.clears and told.lost and arm.master.back), f"{row.name} lasts, and all is told as back")
        fault.check()
        for _ in range(5):
            arm.pass_time(KEPT / 5)
            self._hear(row, told, heard, began)
        pairs = [(one.code, one.source) for one in heard]
        require(len(set(pairs)) == len(pairs), f"{row.name}: {heard} has a fault twice")
        fault.end()
        arm.boards.see("foreign")
        arm.calm = True
        arm.see("begins")
        self._come_back(row, told)

    def _hear(self, row: Row, told: Told, heard: list[Any], began: float) -> bool:
        master = self.arm.master
        new = master.faults.drain()
        if told.warns:
            new += [one for one in master.warnings() if one.code in told.codes and one not in heard]
        for one in new:
            heard.append(one)
            ours = one.code in told.codes
            require(ours or one.code in told.also, f"{row.name}: {one} is told; {told} has a cause")
            if ours and one.code not in told.also:
                right = not told.sources or one.source in told.sources
                right &= all(word in one.message for word in told.words)
                require(right, f"{row.name}: {one} is told; {told} has a cause")
                after = self.arm.now - began
                require(after >= told.least, f"{row.name} is told after {after:g} s")
        return any(one.code in told.codes for one in heard)

    def _come_back(self, row: Row, told: Told) -> None:
        arm, master = self.arm, self.arm.master
        until = arm.now + BACK
        while not master.back:
            require(arm.now < until, f"{row.name}: nothing is back {BACK:g} s after its end")
            arm.call(lambda m: m.probe_silent(arm.now))
            arm.pass_time(PROBES)
        if told.warns:
            still = [one for one in master.warnings() if one.code in told.codes]
            require(not still, f"{row.name} is over, and warned is {still}")
        if (told.warns or not told.codes) and not told.lost and told.beats:
            master.switching.drain()
            arm.ready = True
            arm.see("readies")
            arm.settle()
            require(not master.faults.drain(), f"{row.name} is told later")
            return
        for bus in arm.buses.values():
            bus.drop()
        arm.pass_time(0.03)
        if not told.beats:
            arm.lose_master(0.0)  # boards that have lost the master notice it before the boot
        master.faults.drain()
        master.switching.drain()
        if self.random.random() < 0.3:
            self._change_executor(1.0)  # a board may wait less for heartbeats now
        arm.boot(new=self.random.random() < 0.3)

    def _trouble(self) -> None:
        """Two faults at once while the arm is switched, boots or rests, and its executor ends pulses at each tick."""
        arm, random = self.arm, self.random
        arm.ready = arm.calm = False
        ends: list[Fault] = []

        def strike() -> None:
            if (drawn := self._beside.draw(arm, alone=False)) is not None:
                row, fault = drawn
                arm.made[f"beside: {row.name}"] += 1
                self.note(f"beside: {row.name}")
                ends.append(fault)
                fault.begin()
                arm.agenda.after(random.uniform(0.0, row.longest), lambda: fault in ends and fault.end())

        arm.commit(arm.drawn_states())
        arm.pass_time(random.choice([0.0, 0.0005, 0.02]))
        arm.releases = random.random() < 0.3
        strike()
        arm.pass_time(random.choice([0.0, 0.02, 0.5]))
        arm.releases = True
        arm.start_trouble_boot()
        arm.agenda.after(random.uniform(0.0, 0.15), strike)
        arm.pass_time(0.2)
        arm.wait(arm.at_rest, LONGEST_BOOT, "booted")
        arm.pass_time(0.3)
        arm.releases = False
        for fault in ends:
            fault.end()
        ends.clear()
        arm.mend()
        arm.pass_time(0.02)
        if any(arm.board(name).state is State.STOPPED for name in arm.looks):
            arm.repair()
        arm.wait(lambda: arm.master.calm, LONGEST_BOOT, "calm")  # a slow board may still take a write of this master
        arm.boot(new=True)

    def counted(self) -> Counter[str]:
        """Returns what all arms so far have met."""
        made = Counter({f"fieldbus: {what}": count for what, count in self.arm.made.items()})
        return self._made + made + self.arm.statements.counts()

    def counts(self) -> Counter[str]:
        made = self._alone.made + self._commands.made
        return self.counted() + Counter({f"fieldbus: fault: {name}": count for name, count in made.items()})

    def note(self, event: object) -> None:
        self.events.append((self.agenda.now, event))

    def story(self) -> str:
        return "\n".join(f"{time - 1000:.6f} {event}" for time, event in self.events)
