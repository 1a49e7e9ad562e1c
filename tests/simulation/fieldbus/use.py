"""The use of an arm whose boards are ready: switches, pulses and rests."""

from __future__ import annotations

from tests.simulation.faults.fault import Switch
from tests.simulation.fieldbus.life import Life
from tests.simulation.statements.boards import INVALID, bits_in, bytes_of
from tests.simulation.statements.objects import LIVE, TIMES
from tests.simulation.verdict import require

COMMITTED = 0.6  # [s] until a command must be over
READ_AT_ONCE = 0.05  # [s] until outputs without end-stops, and those of ended pulses, are read back
LATE = 0.004  # [s] from a change of pins until the master tells it
AT_ONCE = 254  # first transmission type of an RPDO that does not wait for SYNC


class UsedArm(Life):
    """An arm that is switched, judged while nothing disturbs it."""

    def use(self) -> None:
        """Switches a few times, and lets the arm rest."""
        for _ in range(self.random.choice([1, 2, 3])):
            self.switch(self.drawn_states())
            self.pass_time(self.random.choice([0.03, 0.1]))
        self.release_pulses()
        self.settle()
        sent = self.handed_out
        self.commit(self.driven())
        require(not self.moves() and self.handed_out == sent, "a command that changes nothing sends frames")
        require(not self.master.faults.drain(), "faults without a cause")

    def drawn_states(self) -> int:
        return self.possible(self.random.getrandbits(self.judged.lines.bit_length()) & self.judged.lines)

    def possible(self, states: int) -> int:
        """Returns states in which no actuator has both outputs on."""
        for i, k in enumerate(self.wiring.paired):
            if states >> k & 1:
                states &= ~(1 << len(self.wiring.channels) + i)
        return states

    def switch(self, states: int) -> None:
        changed = self.driven() ^ states
        self._send(states, states, "switches")
        if self.random.random() < 0.7:
            master = self.master
            read = lambda: not master.outputs.unproven | master.outputs.released  # noqa: E731
            self.wait(read, READ_AT_ONCE + self.sight.slack, "read back")
        self.see("switched", changed)

    def release_pulses(self) -> None:
        if on := self.driven() & self.judged.pulsed:
            self._send(~on & self.judged.lines, self.driven() & ~on, "releases")
            self.wait(lambda: not self.master.outputs.released, READ_AT_ONCE + self.sight.slack, "read back off")
            self.see("switched", on)

    def _send(self, states: int, after: int, what: str) -> None:
        """Gives a command, and requires that it switches all at once, tells when, and changes nothing else."""
        self.note(f"{what} {states:b}")
        master, before, began = self.master, self.driven(), self.now
        unread = before & ~after & self.judged.pulsed & master.outputs.unproven
        objects = {name: self.kept(name) for name in self.looks}
        self.see("commands")
        if what == "releases":
            self.release(~states)
        else:
            self.commit(states)
        self.wait(lambda: not self.moves(), COMMITTED, "committed")
        self.made[what] += 1
        driven, told, failed = self.driven(), master.outputs.commanded, master.switching.failed
        require(driven == after == told, f"{driven:b} are driven after a command of {after:b}: {failed}")
        require(failed is None and self.now - began <= 0.3 + self.sight.slack, f"{self.now - began:g} s: {failed}")
        switched = master.switching.drain()
        told = sum(mask for mask, _ in switched)
        require(told == before ^ after, f"{switched} is told as switched; {before ^ after:b} has")
        moments = [self.moved_at[name] for name in self.looks]
        late = [one for one in switched if min(abs(one[1] - at) for at in moments) > LATE]
        require(not late, f"{late} is told as switched; the pins have changed at {self.moved_at}")
        missed = master.outputs.drain_missed()
        require(not missed & ~unread, f"pulses {missed:b} are missed; {unread:b} have ended unread")
        changed = [name for name in self.looks if self.kept(name) != objects[name]]
        require(not changed, f"a command changes objects of {changed} that are no outputs")

    def kept(self, name: str) -> dict[tuple[int, int], int]:
        """Returns the objects of a board that no command changes."""
        free, look = {*LIVE, *TIMES, self.judged.boards[name].base}, self.looks[name]
        described = self.board(name).objects.described
        return {(i, sub): look.number(i, sub) for i in described if i not in free for sub in described[i]}

    def release_quietly(self) -> None:
        """Switches the lines of pulses off after a fault, unjudged."""
        on = self.master.outputs.commanded & self.judged.pulsed
        if on:
            self.release(on)
            self.wait(lambda: not self.moves(), COMMITTED, "released")
        self.forget()

    def forget(self) -> None:
        """Drops what the master tells of an unjudged command."""
        self.master.switching.drain()
        self.master.outputs.drain_missed()

    # --- what faults need

    def ignored(self, bus: str) -> int:
        """Returns how many frames of a bus the master has not understood; 0 without a master."""
        buses = self.running.status().buses if self.running is not None else ()
        return sum(status.ignored for status in buses if status.name == bus)

    def waits(self, name: str) -> bool:
        """Returns whether a board switches with SYNC."""
        return all(self.looks[name].number(index, 2) < AT_ONCE for index in self.rpdos(name))

    def rpdos(self, name: str) -> list[int]:
        """Returns the enabled RPDOs of a board that carry used outputs."""
        board, look = self.judged.boards[name], self.looks[name]
        here = [index for index in range(0x1400, 0x1440) if look.has(index, 1) and not look.number(index, 1) & INVALID]
        return [index for index in here if bits_in(look.mapping(index), board.base) & board.used]

    def lines_of(self, bus: str, cob_id: int) -> int:
        """Returns the mask of the lines that an RPDO of a bus carries."""
        lines = 0
        for name, board in self.judged.boards.items():
            look = self.looks[name]
            taken = [i for i in self.rpdos(name) if board.bus == bus and look.number(i, 1) & 0x7FF == cob_id]
            bits = sum(bits_in(look.mapping(index), board.base) for index in taken)
            lines |= sum(wire.line for wire in board.outputs if bits >> wire.bit & 1)
        return lines

    def lines_on(self, bus: str) -> int:
        return sum(board.lines for board in self.judged.boards.values() if board.bus == bus)

    def switch_on(self, name: str) -> Switch | None:
        board, states = self.judged.boards[name], self.driven()
        lines = [wire.line for wire in board.outputs if not wire.line & self.judged.pulsed]
        if not lines or states & self.judged.pulsed or not self.waits(name):
            return None
        line = self.random.choice(lines)
        if self.possible(states ^ line) != states ^ line:
            return None
        place = board.base, bytes_of(board.levels_of(states ^ line) ^ board.levels_of(states))[0]
        return Switch(lambda: self.commit(states ^ line), place, 3 * self.sight.slack)

    def reads_outputs(self, name: str) -> bool:
        return not self.driven() & self.judged.pulsed
