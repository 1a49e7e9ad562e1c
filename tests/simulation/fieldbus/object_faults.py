"""Faults that the reads in turn find: objects that change, cannot be read, or tell an error."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from hyperbit.drivers.canopen.wire.cia301 import SYNC, Frame
from tests.simulation.fieldbus.expected import Expected, Fault
from tests.simulation.fieldbus.fault_maker import FaultMaker
from tests.simulation.fieldbus.found import WORDS
from tests.simulation.judge.fieldbus.needs import needs_of
from tests.simulation.judge.fieldbus.wires import bytes_of
from tests.simulation.judge.verdict import require

if TYPE_CHECKING:
    from tests.simulation.fieldbus.world import BoardWorld

LONGEST_TURN = 6.0  # [s] that is worth waiting for
READ_BACK = 1.8  # [s] from a switch until outputs that do not follow are told: about a second, and eight reads
READ_AT_ONCE = 0.75  # [s], likewise if no end-stop tells: eight reads
THREE_READS = 3.5  # [s]
CODES = (0x2310, 0x5000, 0x8F00)


class ObjectFaults(FaultMaker):
    def __init__(self, world: BoardWorld) -> None:
        super().__init__(world)
        self._found = world.found[self._name]
        self._turn = world.watching.turn(self._judged.bus, world.found) + 60 * self._board.variant.answer_delay

    def object_is_changed(self) -> Fault | None:
        if self._turn > LONGEST_TURN:
            return None
        objects = self._board.objects
        index, sub = self._random.choice(sorted(self._world.watching.watched(self._judged, self._found)))
        _, masks = needs_of(self._judged, self._found)
        before = objects.number(index, sub)
        bits = masks.get((index, sub), (1 << 8 * objects.find(index, sub).size) - 1)
        if index == 0x1017:
            return None  # its heartbeats would be missing first
        if index in (0x1016, 0x100C):  # boards round times
            bits = 0xF000
        elif (index & 0x1F00) in (0x1400, 0x1800) and sub == 1:
            bits &= 1 << 31 | 0x7FF
        flips = [1 << k for k in range(32) if bits >> k & 1]
        value = before ^ self._random.choice(flips)
        words = (f"{index:04X}h sub {sub}", "is needed", "another program")
        expected = Expected(("board-changed",), self._name, words, self._turn, (self._name,))
        self._world.note(f"{self._name}: {index:04X}h sub {sub} gets {value:X}h")
        return Fault(
            lambda: objects.set_number(index, sub, value), lambda: objects.set_number(index, sub, before), expected
        )

    def unused_bits_are_changed(self) -> Fault | None:
        """Bits that the wiring does not use are of no concern."""
        if self._turn > LONGEST_TURN:
            return None
        objects, (_, masks) = self._board.objects, needs_of(self._judged, self._found)
        places = [
            (place, ~mask & 0xFF)
            for place, mask in masks.items()
            if place[0] in (0x6206, 0x6208, 0x6006) and objects.has(place[0]) and ~mask & 0xFF
        ]
        if not places:
            return None
        (index, sub), bits = self._random.choice(places)
        before = objects.number(index, sub)

        def set_(value: int) -> Any:
            return lambda: objects.set_number(index, sub, value)

        return Fault(set_(before ^ bits), set_(before), Expected((), within=self._turn))

    def error_without_an_emergency(self) -> Fault | None:
        if self._turn > LONGEST_TURN or not self._board.objects.has(0x1003):
            return None
        objects, code = self._board.objects, self._random.choice(CODES)
        register = self._random.choice([1, 0x80, 0x05])
        kept = self._found.keeps_loss and objects.number(0x1001)
        if kept:
            return None

        def cause() -> None:
            objects.set_number(0x1003, 1, code)
            objects.set_number(0x1003, 0, 1)
            objects.set_number(0x1001, 0, register)

        words = (f"1001h sub 0 is {register:02X}h", "1003h sub 1 is", f"({code:04X}h)", "Remove the cause")
        expected = Expected(("board-error",), self._name, words, self._turn + 0.5)

        def mend() -> None:
            objects.set_number(0x1001, 0, 0)

        return Fault(cause, mend, expected)

    def error_for_a_moment(self) -> Fault | None:
        """A register that is read once is no error yet."""
        objects = self._board.objects
        if objects.number(0x1001):
            return None
        seen: list[int] = []

        def read(bus: str, frame: Frame) -> str:
            asked = (
                bus == self._judged.bus and frame.id == 0x600 + self._judged.node and frame.data[1:4] == b"\x01\x10\x00"
            )
            if asked:
                seen.append(1)
                objects.set_number(0x1001, 0, 1 if len(seen) == 1 else 0)
            return ""

        def cause() -> None:
            self._site.intercept = read

        def mend() -> None:
            self._site.intercept = lambda bus, frame: ""
            objects.set_number(0x1001, 0, 0)

        return Fault(cause, mend, Expected((), within=min(self._turn, LONGEST_TURN)))

    def new_error_among_kept_ones(self) -> Fault | None:
        """An error that a board keeps from before is known; only a new entry of its history tells another one."""
        objects = self._board.objects
        if self._turn > LONGEST_TURN or not (self._found.keeps_loss and objects.number(0x1001)):
            return None
        expected = Expected(("board-error",), self._name, ("1001h sub 0 is 11h", "(2310h)"), self._turn + 0.5)

        def cause() -> None:
            objects.set_number(0x1003, 1, 0x2310)

        return Fault(
            cause,
            lambda: self._site.boards.fault("power_cut", self._name) or self._site.boards.fault("power_on", self._name),
            expected,
        )

    def outputs_are_changed(self) -> Fault | None:
        """Another program writes outputs, which the reads in turn find."""
        if (
            self._turn > LONGEST_TURN
            or not self._judged.used
            or self._world.switching.states & self._world.wiring.pulsed
        ):
            return None
        objects, base = self._board.objects, self._judged.base
        sub = self._random.choice(bytes_of(self._judged.used))
        used = self._judged.used >> 8 * (sub - 1) & 0xFF
        bit = self._random.choice([1 << k for k in range(8) if used >> k & 1])
        before = objects.number(base, sub)
        right = self._judged.levels_of(self._world.switching.states) >> 8 * (sub - 1) & 0xFF
        words = (f"{used & (before ^ bit):02X}h in {base:04X}h sub {sub} (outputs)", f"{right:02X}h was switched")
        expected = Expected(("not-switched",), self._name, words, self._turn + 0.6, (self._name,))

        def cause() -> None:
            objects.set_number(base, sub, before ^ bit)

        return Fault(cause, lambda: objects.set_number(base, sub, before), expected)

    def outputs_that_are_not_used_are_changed(self) -> Fault | None:
        if self._turn > LONGEST_TURN or not self._judged.used:
            return None
        objects, base = self._board.objects, self._judged.base
        sub = bytes_of(self._judged.used)[0]
        unused = ~self._judged.used >> 8 * (sub - 1) & 0xFF
        before = objects.number(base, sub)

        def set_(value: int) -> Any:
            return lambda: objects.set_number(base, sub, value)

        return Fault(set_(before ^ unused), set_(before), Expected((), within=self._turn))

    def _switched(self) -> int | None:
        """Returns states in which a line of the board has changed, without pulses; None if there is none."""
        lines = [w.line for w in self._judged.outputs if not w.line & self._world.wiring.pulsed]
        if not lines or self._world.switching.states & self._world.wiring.pulsed:
            return None
        states = self._world.switching.states ^ self._random.choice(lines)
        return states if self._world.use.possible(states) == states else None

    def board_loses_a_SYNC(self) -> Fault | None:
        states = self._switched()
        parts = self._world.switching.parts_of(self._name)
        if states is None or not all(part.waits for part in parts):
            return None
        lost: list[str] = []

        def lose(bus: str, frame: Frame) -> str:
            if bus != self._judged.bus or frame.id != SYNC:
                return ""
            lost.append(bus)
            return "lose"

        def cause() -> None:
            self._site.intercept = lose
            self._site.call(lambda m: m.commit(states, self._world.agenda.now))

        def mend() -> None:
            self._site.intercept = lambda bus, frame: ""

        here = tuple(
            n for n, b in self._world.wiring.boards.items() if b.lines & (states ^ self._world.switching.states)
        )
        if here != (self._name,):
            return None
        words = ("does not follow RPDO and SYNC", "(outputs)")
        blind = self._judged.unsensed & (states ^ self._world.switching.states)
        within = (READ_AT_ONCE if blind else READ_BACK) + 3 * self._world.watching.slack
        expected = Expected(("not-switched",), self._name, words, within, here)
        return Fault(cause, mend, expected)

    def outputs_cannot_be_read(self) -> Fault | None:
        states = self._switched()
        if states is None:
            return None
        objects, code = self._board.objects, next(iter(WORDS))
        changed = self._judged.levels_of(states) ^ self._judged.levels_of(self._world.switching.states)
        place = self._judged.base, bytes_of(changed)[0]
        [before] = [s.unverified for s in self._world.master.status().boards if f"{s.bus}/{s.node}" == self._name]

        def cause() -> None:
            objects.refused[place] = code
            self._site.call(lambda m: m.commit(states, self._world.agenda.now))

        def check() -> None:
            [now] = [s.unverified for s in self._world.master.status().boards if f"{s.bus}/{s.node}" == self._name]
            require(now == before + 3, f"{self._name}: {now} are unverified, were {before}; three reads have failed")

        words = (f"{place[0]:04X}h sub {place[1]} (outputs)", "3 times in a row", "hardware error")
        within = THREE_READS + self._world.watching.slack
        expected = Expected(("not-verified",), self._name, words, within, (self._name,))
        return Fault(cause, objects.refused.clear, expected, check)

    def answers_come_twice(self) -> Fault | None:
        """Two boards have one node id: each SDO is answered twice."""
        if self._turn > LONGEST_TURN:
            return None

        def twice(bus: str, frame: Frame) -> str:
            return "twice" if bus == self._judged.bus and frame.id == 0x580 + self._judged.node else ""

        def cause() -> None:
            self._site.intercept = twice

        def mend() -> None:
            self._site.intercept = lambda bus, frame: ""

        words = ("two boards", self._name)
        expected = Expected(("duplicate-node",), self._name, words, 1.5 * self._turn + 2.0, (self._name,))
        return Fault(cause, mend, expected)

    def answers_are_lost_once(self) -> Fault | None:
        """An SDO answer that is lost is asked for again."""
        left = [self._random.choice([1, 2])]

        def lose(bus: str, frame: Frame) -> str:
            if left[0] and bus == self._judged.bus and frame.id == 0x580 + self._judged.node:
                left[0] -= 1
                return self._random.choice(["lose", "late"])
            return ""

        def cause() -> None:
            self._site.intercept = lose

        def mend() -> None:
            self._site.intercept = lambda bus, frame: ""

        return Fault(cause, mend, Expected((), within=1.5))
