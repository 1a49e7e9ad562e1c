"""While boards run: heartbeats, polls of node guarding, reads in turn, and what is told of inputs and boards."""

from __future__ import annotations

from collections import Counter
from itertools import pairwise
from typing import Any

from tests.simulation.fieldbus.judge.needs import RPDOS, TPDOS, needs_of
from tests.simulation.fieldbus.judge.outcomes import Found, beats
from tests.simulation.fieldbus.judge.wires import INPUTS, INVALID, JudgedBoard, JudgedWiring, Look, bits_in, bytes_of
from tests.simulation.verdict import require

TICK = 0.01
FRAME_BITS, SHARE, PACE = 135, 0.01, 0.05  # reads in turn: share of the bit rate, and shortest time between two [s]
INPUTS_EVERY = 1.5  # [s] between two reads of the inputs of a board with an interlock
HEARTBEAT, REMOTE = 0x77F, 1 << 30
STOPPED = 4


class Watching:
    """Judges the frames of a master whose boards run without trouble.

    Attributes:
        reads: number of reads since the boards are ready, by board, index and sub-index.
        further: reads by bus that switches have caused.
        standing: boards that keep an error.
        slow: boards whose answers take longer than the time between two reads.
        slack: [s] more for reads where boards answer slowly.
    """

    def __init__(self, wiring: JudgedWiring, looks: dict[str, Look]) -> None:
        self._wiring, self._looks = wiring, looks
        self._period = wiring.timing.heartbeat
        self.further: dict[str, int] = {}
        self.standing = self.slow = frozenset[str]()
        self.slack = 0.0
        self.now = 0.0
        self.restart(0.0)

    def restart(self, now: float) -> None:
        """A new time without trouble begins."""
        self.now = self._since = now
        self._beats: dict[str, float] = {}
        self._polls: dict[str, float] = {}
        self.reads: Counter[tuple[str, int, int]] = Counter()
        self.input_reads: dict[str, list[float]] = {}
        self.output_reads: dict[str, float] = {}  # last read of each board
        self.ready_since: float | None = None
        self._count: Counter[str] = Counter()

    def ready(self, now: float) -> None:
        """All boards are ready: from now on reads are counted."""
        self.ready_since = now
        self.reads.clear()
        self.output_reads.clear()
        self._count.clear()
        self.input_reads.clear()

    def hands_out(self, bus: str, cob_id: int, data: bytes, now: float) -> None:
        if cob_id == HEARTBEAT:
            require(data == b"\x05", f"{bus}: the heartbeat of the master is {data.hex()}")
            before = self._beats.get(bus)
            if before is not None:
                gap = now - before
                require(gap >= self._period - TICK, f"{bus}: a heartbeat of the master {gap:g} s after another one")
            self._beats[bus] = now
        elif cob_id & REMOTE:
            name = f"{bus}/{cob_id & 0x7F}"
            right = cob_id & 0x780 == 0x700 and name in self._looks
            require(right, f"{bus}: a remote frame {cob_id & 0x7FF:03X}h")
            before = self._polls.get(name)
            if before is not None and self.ready_since is not None:
                gap = now - before
                require(gap >= self._period / 2 - 1e-6, f"{name} is polled {gap:g} s after another poll")
            if self.ready_since is not None:
                require(self.guarded(name), f"{name} has heartbeats, and is polled")
            self._polls[name] = now
        elif cob_id & ~0x7F == 0x600 and self.ready_since is not None:
            name = f"{bus}/{cob_id & 0x7F}"
            index, sub = int.from_bytes(data[1:3], "little"), data[3]
            require(data[0] == 0x40, f"{name}: SDO {data.hex()} while all are ready")
            self.reads[name, index, sub] += 1
            self._count[bus] += 1
            if index == self._wiring.boards[name].base:
                self.output_reads[name] = now
            if index == INPUTS:
                self.input_reads.setdefault(name, []).append(now)

    def guarded(self, name: str) -> bool:
        """Returns whether node guarding supervises a board."""
        look = self._looks[name]
        return not (look.has(0x1016) and look.has(0x1017))

    def tick(self, now: float) -> None:
        self.now = now
        for bus in self._wiring.buses:
            gap = now - max(self._beats.get(bus, self._since), self._since)
            require(gap <= self._period + 2 * TICK, f"{bus}: no heartbeat of the master for {gap:g} s")
        if self.ready_since is None:
            return
        for name in self._looks:
            if self.guarded(name):
                gap = now - max(self._polls.get(name, self.ready_since), self.ready_since)
                require(gap <= self._period + 2.5 * TICK, f"{name} is not polled for {gap:g} s")

    def pace(self, bus: str) -> float:
        """Returns the time between two reads in turn on a bus [s]."""
        return max(PACE, 2 * FRAME_BITS / (SHARE * self._wiring.rates[bus]))

    def turn(self, bus: str, found: dict[str, Found]) -> float:
        """Returns the time in which all objects of all boards of a bus are read [s]."""
        here = [board for board in self._wiring.boards.values() if board.bus == bus]
        most = max(len(self.watched(board, found[board.name])) + 8 for board in here)
        return 1.3 * most * len(here) * self.pace(bus) + 0.3 + 10 * self.slack

    def inputs_every(self, name: str) -> float:
        """Returns the longest time between two reads of the inputs of a board [s]."""
        board = self._wiring.boards[name]
        if board.interlocked:
            return INPUTS_EVERY
        others = [b for b in self._wiring.boards.values() if b.bus == board.bus and not b.interlocked]
        count = sum(len(bytes_of(other.sensed)) for other in others)
        return max(INPUTS_EVERY, count * 2 * FRAME_BITS / (SHARE * self._wiring.rates[board.bus]))

    def watched(self, board: JudgedBoard, found: Found) -> set[tuple[int, int]]:
        """Returns the objects of a board that must be read in turn: all that the boot needs."""
        look = self._looks[board.name]
        needs, _ = needs_of(board, found)
        places = {place for place in needs if found.has(*place) and place != (0x1014, 0)} | {(0x1014, 0)}
        if beats(found):
            entries = range(1, look.number(0x1016, 0) + 1)
            places |= {(0x1016, sub) for sub in entries if look.number(0x1016, sub) >> 16 & 0x7F == 127} | {(0x1017, 0)}
        else:
            places |= {(0x100C, 0), (0x100D, 0)}
        for first, base, used in ((RPDOS, board.base, board.used), (TPDOS, INPUTS, board.sensed)):
            for index in first:
                cob_id = look.number(index, 1)
                ours = cob_id & 0x7F == board.node or cob_id & 0x7FF in [pdo.cob_id for pdo in board.rpdos]
                if not look.has(index) or cob_id & INVALID or not ours:
                    continue
                mapping = [look.number(index + 0x200, 1 + k) for k in range(look.number(index + 0x200, 0))]
                if bits_in(mapping, base) & used:
                    places |= {(index, 1), (index, 2), (index + 0x200, 0)}
                    places |= {(index + 0x200, 1 + k) for k in range(len(mapping))}
        return {place for place in places if found.has(*place)}

    def judge_turn(self, found: dict[str, Found]) -> None:
        """Requires that all objects were read since the boards are ready: once in a turn, no more than needed."""
        assert self.ready_since is not None
        seconds = self.now - self.ready_since
        for name, board in self._wiring.boards.items():
            if seconds < self.turn(board.bus, found) or name in self.slow:
                continue
            places = self.watched(board, found[name]) | {(0x1001, 0)} | {(board.base, s) for s in bytes_of(board.used)}
            unread = sorted(place for place in places if not self.reads[name, place[0], place[1]])
            shown = ", ".join(f"{index:04X}h sub {sub}" for index, sub in unread)
            require(not unread, f"{name}: {shown} are not read within {seconds:.1f} s")
        self.judge_rate()

    def judge_rate(self) -> None:
        """Requires that reads leave the bus to others."""
        assert self.ready_since is not None
        seconds = self.now - self.ready_since
        for bus, count in self._count.items():
            here = [board for board in self._wiring.boards.values() if board.bus == bus]
            inputs = sum(len(bytes_of(b.sensed)) * (seconds / self.inputs_every(b.name) + 1) for b in here)
            outputs = sum(len(bytes_of(b.used)) for b in here)
            most = (seconds / self.pace(bus) + 2) * (1 + outputs / 10) + inputs + self.further.get(bus, 0)
            require(count <= most, f"{bus}: {count} reads in {seconds:.2f} s; {most:.0f} are enough")

    def judge_inputs(self) -> None:
        """Requires that inputs are read in turn."""
        assert self.ready_since is not None
        for name, board in self._wiring.boards.items():
            if not board.sensed:
                continue
            times = [self.ready_since, *self.input_reads.get(name, []), self.now]
            longest = self.inputs_every(name) + 0.35 + self.slack
            gap = max(after - before for before, after in pairwise(times))
            require(gap <= longest, f"the inputs of {name} are not read for {gap:.2f} s")

    def judge_told(self, master: Any, outputs: int | None) -> None:
        """Judges what the master tells of inputs, outputs and boards, while all are ready."""
        wiring = self._wiring
        ends = inputs = 0
        for board in wiring.boards.values():
            ends |= board.read(self._looks[board.name].inputs())
            inputs |= board.input_lines
        require(master.ends == ends, f"inputs are told as {master.ends:b}; they read {ends:b}")
        require(master.inputs_known == inputs, f"inputs {master.inputs_known:b} are known; {inputs:b} are")
        require(master.known == wiring.actuators, f"actuators {master.known:b} are known; all are")
        require(master.board_of == wiring.board_of, f"{master.board_of} are told as boards of the actuators")
        require(master.outputs_known and master.back, "the master is not ready")
        require(not master.doubtful, f"outputs {master.doubtful:b} are doubtful")
        if outputs is not None:
            require(master.outputs == outputs, f"outputs are told as {master.outputs:b}; they are {outputs:b}")
        for told in master.status().boards:
            name = f"{told.bus}/{told.node}"
            require(told.state == "operational", f"{name} is told as {told.state}")
            age = told.heartbeat_age
            young = age is not None and -TICK <= age <= 2 * self._period + 0.03
            require(young, f"{name}: its heartbeat is {age} s old")
            require(told.emergency is None or name in self.standing, f"{name}: emergency {told.emergency} is told")
