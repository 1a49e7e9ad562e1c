"""The use of an arm whose boards are ready: switches, rests, and turns of all reads."""

from __future__ import annotations

from tests.simulation.faults.fault import Switch
from tests.simulation.fieldbus.judge.wires import bytes_of
from tests.simulation.fieldbus.life import Life
from tests.simulation.verdict import require

COMMITTED = 0.6  # [s] until a command must be over
LONGEST_TURN = 12.0  # [s] of reads that is worth waiting for


class UsedArm(Life):
    """An arm that is switched, judged while nothing disturbs it."""

    def use(self) -> None:
        """Switches a few times, and lets the arm rest."""
        random = self.random
        for _ in range(random.choice([1, 2, 3])):
            self.switch(self.drawn_states())
            self.pass_time(random.choice([0.03, 0.1]))
        self.release_pulses()
        if random.random() < 0.25:
            self.pass_time(random.choice([1.2, 2.2]))
            self.watching.judge_inputs()
        self.watching.judge_rate()
        self.settle()
        require(not self.master.drain_faults(), "faults without a cause")

    def drawn_states(self) -> int:
        return self.possible(self.random.getrandbits(self.judged.lines.bit_length()) & self.judged.lines)

    def possible(self, states: int) -> int:
        """Returns states in which no actuator has both outputs on."""
        for i, k in enumerate(self.wiring.paired):
            if states >> k & 1:
                states &= ~(1 << len(self.wiring.channels) + i)
        return states

    def switch(self, states: int) -> None:
        master, before = self.master, self.now
        changed = self.switching.states ^ states
        ending = self.switching.states & ~states & self.judged.pulsed & master.unread
        self.switching.commands(states)
        self._send(states, "switches")
        require(self.now - before <= 0.3 + self.watching.slack, f"a command takes {self.now - before:.3f} s")
        self._judge_missed(ending)
        if self.random.random() < 0.7:
            self.wait(lambda: not master.unread, COMMITTED + self.watching.slack, "read back")
        for name, board in self.judged.boards.items():
            if changed & board.unsensed & ~master.unread:
                read, unread = name in self.watching.output_reads, master.unread
                require(read, f"{name}: {changed:b} was switched, {unread:b} is unread, and nobody has read outputs")

    def release_pulses(self) -> None:
        if on := self.switching.states & self.judged.pulsed:
            ending = on & self.master.unread
            self.switching.commands(self.switching.states & ~on, on)
            self._send(~on & self.judged.lines, "releases", release=True)
            self._judge_missed(ending)
            self.wait(lambda: not self.master.released, COMMITTED + self.watching.slack, "read back off")

    def _send(self, states: int, what: str, release: bool = False) -> None:
        self.count_reads()
        self.note(f"{what} {states:b}")
        self.commit(states, release)
        self.wait(lambda: not self.moves(), COMMITTED, "committed")
        self.made[what] += 1
        self.switching.ended(self.master.outputs, self.master.drain_switched(), self.master.commit_failed)

    def _judge_missed(self, ending: int) -> None:
        """Requires that only pulses are missed that have ended unread: lines of a mask."""
        missed = self.master.drain_missed()
        require(not missed & ~ending, f"pulses {missed:b} are missed; {ending:b} have ended unread")

    def count_reads(self) -> None:
        for board in self.judged.boards.values():
            more = 12 * max(1, board.used.bit_count())
            self.watching.further[board.bus] = self.watching.further.get(board.bus, 0) + more

    def release_quietly(self) -> None:
        """Switches the lines of pulses off after a fault, unjudged."""
        on = self.master.outputs & self.judged.pulsed
        if on:
            self.commit(~on & self.judged.lines, release=True)
            self.wait(lambda: not self.moves(), COMMITTED, "released")
        self.forget()

    def forget(self) -> None:
        """The arm is switched as it is, whatever was commanded."""
        self.switching.forget(self.switching.driven())
        self.master.drain_switched()
        self.master.drain_missed()
        self.count_reads()

    def read_all(self) -> None:
        self.made["all objects are read"] += 1
        self.watching.ready(self.now)
        self.watching.further = {}
        longest = max(self.watching.turn(bus, self.found) for bus in self.judged.buses)
        if longest <= LONGEST_TURN:
            self.pass_time(longest + 0.05)
            self.watching.judge_turn(self.found)
            self.watching.judge_inputs()
            self.settle()

    def waits(self, name: str) -> bool:
        """Returns whether a board switches with SYNC."""
        return all(part.waits for part in self.switching.parts_of(name))

    def switch_on(self, name: str) -> Switch | None:
        board, states = self.judged.boards[name], self.switching.states
        lines = [wire.line for wire in board.outputs if not wire.line & self.judged.pulsed]
        if not lines or states & self.judged.pulsed or not self.waits(name):
            return None
        line = self.random.choice(lines)
        changed = board.levels_of(states ^ line) ^ board.levels_of(states)
        if self.possible(states ^ line) != states ^ line:
            return None
        place = board.base, bytes_of(changed)[0]
        return Switch(lambda: self.commit(states ^ line), place, 3 * self.watching.slack)

    def reads_outputs(self, name: str) -> bool:
        return not self.switching.states & self.judged.pulsed
