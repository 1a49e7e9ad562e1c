"""The use of an arm whose boards are ready: switches, rests, and turns of all reads."""

from __future__ import annotations

from typing import TYPE_CHECKING

from tests.simulation.judge.verdict import require

if TYPE_CHECKING:
    from hyperbit.drivers.canopen.run.master import Master
    from tests.simulation.fieldbus.world import BoardWorld

COMMITTED = 0.6  # [s] until a command must be over
LONGEST_TURN = 12.0  # [s] of reads that is worth waiting for


def moves(master: Master) -> bool:
    """Whether frames on their way may still switch something."""
    return bool(master.committing or master.collecting or master.leaving)


class Use:
    """Uses an arm without trouble, and judges it."""

    def __init__(self, world: BoardWorld) -> None:
        self._world = world

    def happen(self) -> None:
        """Switches a few times, and lets the arm rest."""
        random, master = self._world.random, self._world.master
        for _ in range(random.choice([1, 2, 3])):
            self.switch(random.getrandbits(self._world.wiring.lines.bit_length()) & self._world.wiring.lines)
            self._world.pass_time(random.choice([0.03, 0.1]))
        self.release_pulses()
        if random.random() < 0.25:
            self._world.pass_time(random.choice([1.2, 2.2]))
            self._world.watching.judge_inputs()
        self._world.watching.judge_rate()
        self._world.settle()
        require(not master.drain_faults(), "faults without a cause")

    def switch(self, states: int) -> None:
        master = self._world.master
        states = self.possible(states)
        before = self._world.agenda.now
        changed = self._world.switching.states ^ states
        ending = self._world.switching.states & ~states & self._world.wiring.pulsed & master.unread
        self._world.switching.commands(states)
        self._count_reads()
        self._world.note(f"commit {states:b}")
        self._world.site.call(lambda m: m.commit(states, before))
        self._world.wait(lambda: not moves(master), COMMITTED, "committed")
        self._world.made["switches"] += 1
        self._world.switching.ended(master.outputs, master.drain_switched(), master.commit_failed)
        self._judge_ending(before)
        self._judge_missed(ending)
        if self._world.random.random() < 0.7:
            self._world.wait(lambda: not master.unread, COMMITTED + self._world.watching.slack, "read back")
        self._judge_read_back(changed)

    def _judge_read_back(self, changed: int) -> None:
        """Requires that outputs without end-stops count as read back after they were read, and not before."""
        world, unread = self._world, self._world.master.unread
        for name, board in world.wiring.boards.items():
            if changed & board.unsensed & ~unread:
                read = name in world.watching.output_reads
                require(read, f"{name}: {changed:b} was switched, {unread:b} is unread, and nobody has read outputs")

    def _judge_missed(self, ending: int) -> None:
        """Requires that only pulses are missed that have ended unread: lines of a mask."""
        missed = self._world.master.drain_missed()
        require(not missed & ~ending, f"pulses {missed:b} are missed; {ending:b} have ended unread")

    def _judge_ending(self, before: float) -> None:
        seconds = self._world.agenda.now - before
        require(seconds <= 0.3 + self._world.watching.slack, f"a command takes {seconds:.3f} s")

    def possible(self, states: int) -> int:
        """Returns states in which no actuator has both outputs on."""
        channels = self._world.drawn.wiring.channels
        for i, k in enumerate(self._world.drawn.wiring.paired):
            if states >> k & 1:
                states &= ~(1 << len(channels) + i)
        return states

    def _count_reads(self) -> None:
        for board in self._world.wiring.boards.values():
            further = self._world.watching.further
            further[board.bus] = further.get(board.bus, 0) + 12 * max(1, board.used.bit_count())

    def release_pulses(self) -> None:
        on = self._world.switching.states & self._world.wiring.pulsed
        if not on:
            return
        master, now = self._world.master, self._world.agenda.now
        states = self._world.switching.states & ~on
        self._world.switching.commands(states, on)
        ending = on & master.unread
        self._count_reads()
        self._world.note(f"release {on:b}")
        self._world.site.call(lambda m: m.commit(~on & self._world.wiring.lines, now, release=True))
        self._world.wait(lambda: not moves(master), COMMITTED, "released")
        self._world.made["releases"] += 1
        self._world.switching.ended(master.outputs, master.drain_switched(), master.commit_failed)
        self._judge_missed(ending)
        self._world.wait(lambda: not master.released, COMMITTED + self._world.watching.slack, "read back off")

    def release_quietly(self) -> None:
        """Switches the lines of pulses off after a fault, unjudged."""
        master = self._world.master
        on = master.outputs & self._world.wiring.pulsed
        if on:
            self._world.site.call(
                lambda m: m.commit(~on & self._world.wiring.lines, self._world.agenda.now, release=True)
            )
            self._world.wait(lambda: not moves(master), COMMITTED, "released")
        self._world.switching.forget(self._world.switching.driven())
        master.drain_switched()
        master.drain_missed()
        self._count_reads()

    def read_all(self) -> None:
        self._world.made["all objects are read"] += 1
        self._world.watching.ready(self._world.agenda.now)
        self._world.watching.further = {}
        longest = max(self._world.watching.turn(bus, self._world.found) for bus in self._world.wiring.buses)
        if longest > LONGEST_TURN:
            return
        self._world.pass_time(longest + 0.05)
        self._world.watching.judge_turn(self._world.found)
        self._world.watching.judge_inputs()
        self._world.settle()
