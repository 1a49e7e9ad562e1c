"""Boots: what becomes of each board, and the frames that the master may send for it."""

from __future__ import annotations

import re
from collections import Counter
from typing import Any

from tests.simulation.fieldbus.judge.needs import judge_objects, needs_of
from tests.simulation.fieldbus.judge.outcomes import (
    LIMITS,
    OPERATIONAL,
    PRE_OPERATIONAL,
    Found,
    Outcome,
    Values,
    beats,
    outcome_of,
)
from tests.simulation.fieldbus.judge.wires import INPUTS, JudgedBoard, JudgedWiring, Look, bytes_of
from tests.simulation.verdict import require

MOST_READS = 10  # of one object in a boot: to find it, to search other PDOs, twice to settle, after writes, at the end
MOST_WRITES = 6  # likewise: to disable and enable a PDO, and the one that is used in its place
MOST_CHECKS = 60  # of 1001h and 1003h, while an error may end
START, PRE = 1, 128
LIVE = frozenset({0x1001, 0x1003, 0x6000})  # objects that a board changes by itself
FRAME_BITS = 135
PDO_NAMES, MOST_PDOS = re.compile(r"[RT]PDO(-?\d+)"), 512
HEARD = 400  # [ms], a board with shorter periods is heard before its first SDO is repeated
PADDED = "its inputs come in"  # words of a warning


class Seen:
    """The SDO requests and NMT commands to one board in a boot."""

    def __init__(self) -> None:
        self.reads: Counter[tuple[int, int]] = Counter()
        self.writes: list[tuple[int, int, int]] = []
        self.orders: list[int] = []
        self.log: list[tuple[str, int, int]] = []  # "read" or "write" or "order", index, sub-index
        self.changed = False  # whether a write had another value than the board
        self.staged: tuple[int, int] | None = None  # object of a write whose second step is missing

    def wrote(self, index: int, sub: int, value: int, present: int) -> None:
        self.writes.append((index, sub, value))
        self.log.append(("write", index, sub))
        self.changed |= present != value


class Boots:
    """Judges boots without trouble, one at a time.

    Attributes:
        found: the boards as the present boot found them.
        requests: SDO requests on each bus.
        left: objects of each board after its last boot.
        failed: boards whose last boot by this master has failed, perhaps after outputs were written.
        repeats: requests for one object that may be repeated.
        allowance: [s] more for boards that answer slowly, or whose errors end by themselves.
    """

    def __init__(self, wiring: JudgedWiring, looks: dict[str, Look]) -> None:
        self._wiring, self._looks = wiring, looks
        self.left: dict[str, Values] = {}
        self.failed: set[str] = set()
        self.repeats, self.allowance = 0, 0.0
        self.found: dict[str, Found] = {}
        self.seen: dict[str, Seen] = {}
        self.running = False
        self.requests: Counter[str] = Counter()

    def begin(self, found: dict[str, Found]) -> None:
        self.found, self.running = found, True
        self.seen = {name: Seen() for name in found}
        self.requests.clear()

    def again(self, name: str) -> None:
        """A board has restarted during the boot: what was done before is lost."""
        self.seen[name] = Seen()

    def hands_out(self, bus: str, cob_id: int, data: bytes) -> None:
        if cob_id == 0:
            name = f"{bus}/{data[1]}"
            require(name in self.seen, f"NMT {data.hex()} for a node that is no board of {bus}")
            self.seen[name].orders.append(data[0])
            self.seen[name].log.append(("order", data[0], 0))
        elif cob_id & ~0x7F == 0x600:
            self._transfer(f"{bus}/{cob_id & 0x7F}", data)
            self.requests[bus] += 1
        else:
            function, found = cob_id & 0x780, self.found.get(f"{bus}/{cob_id & 0x7F}")
            heard = found is not None and found.state is not None and 0 < found.byte(0x1017, 0) <= HEARD
            require(cob_id == 0x77F or not heard, f"{bus}/{cob_id & 0x7F} has heartbeats, and is polled")
            require(cob_id == 0x77F or function == 0x700, f"{bus}: frame {cob_id:03X}h during a boot")

    def _transfer(self, name: str, data: bytes) -> None:
        require(name in self.seen and len(data) == 8, f"SDO {data.hex()} to {name}")
        seen, index, sub = self.seen[name], int.from_bytes(data[1:3], "little"), data[3]
        if data[0] & 0xE0 == 0:  # a segment: the second step of a write
            require(seen.staged is not None and data[0] == 0x0D, f"SDO {data.hex()} to {name} without its first step")
            index, sub = seen.staged or (0, 0)
            seen.staged = None
            seen.wrote(index, sub, data[1], self._looks[name].number(index, sub))
            return
        seen.staged = None
        if data == b"\x21" + data[1:4] + b"\1\0\0\0":
            seen.staged = index, sub
        elif data[0] == 0x40:
            seen.reads[index, sub] += 1
            seen.log.append(("read", index, sub))
        elif data[0] & 0xE3 == 0x23:
            size = 4 - (data[0] >> 2 & 3)
            value = int.from_bytes(data[4 : 4 + size], "little")
            seen.wrote(index, sub, value, self._looks[name].number(index, sub))
        else:
            require(data[0] in (0x60, 0x70, 0x80), f"SDO {data.hex()} to {name}")

    def end(
        self, faults: list[Any], warnings: list[Any], ready: bool, seconds: float, timing: Any
    ) -> dict[str, Outcome]:
        """The boot is over; returns what had to become of the boards.

        Args:
            faults: of the boot, with code, source and message.
            ready: whether the master says that all boards are ready.
            seconds: its length [s].
        """
        self.running = False
        self._judge_words([told.message for told in (*faults, *warnings)])
        outcomes = {}
        for name, found in self.found.items():
            board = self._wiring.boards[name]
            outcomes[name] = outcome = outcome_of(board, found, *needs_of(board, found))
            ours = [fault for fault in faults if fault.source == name]
            self._judge_fault(name, outcome, ours)
            self._judge_traffic(board, found, outcome)
            if outcome.refusals:
                self._judge_refused(board, found, outcome, ours[0].code)
                self.failed.add(name)
            else:
                self._judge_ready(board, found, outcome, warnings, timing)
                self.failed.discard(name)
        others = [fault for fault in faults if fault.source not in self.found]
        require(not others, f"a boot without trouble ends with {others}")
        right = ready == (not any(outcome.refusals for outcome in outcomes.values()))
        require(right, f"ready is {ready} with {faults}")
        if not any(o.refusals for o in outcomes.values()) and all(f.starts for f in self.found.values()):
            self._judge_time(seconds, timing)
        return outcomes

    def _judge_words(self, messages: list[str]) -> None:
        """Requires that PDOs are named as CiA 301 names them."""
        for message in messages:
            wrong = [number for number in PDO_NAMES.findall(message) if not 1 <= int(number) <= MOST_PDOS]
            require(not wrong, f"{message!r} names PDOs {wrong}")

    def _judge_fault(self, name: str, outcome: Outcome, faults: list[Any]) -> None:
        require(len(faults) == bool(outcome.refusals), f"{name}: {faults}; {outcome.refusals} is expected")
        if outcome.refusals:
            fault = faults[0]
            right = any(
                fault.code == refusal.code and all(word in fault.message for word in refusal.words)
                for refusal in outcome.refusals
            )
            require(right and name in fault.message, f"{fault}; {outcome.refusals} is expected")

    def _judge_traffic(self, board: JudgedBoard, found: Found, outcome: Outcome) -> None:
        seen = self.seen[board.name]
        for (index, sub), count in seen.reads.items():
            most = MOST_CHECKS if index in (0x1001, 0x1003) or outcome.refusals else MOST_READS
            most += self.repeats
            require(count <= most, f"{board.name}: {index:04X}h sub {sub} is read {count} times in one boot")
        writes = Counter((index, sub) for index, sub, _ in seen.writes)
        for (index, sub), count in writes.items():
            require(found.has(index, sub), f"{board.name}: {index:04X}h sub {sub} is written, and is not there")
            require(
                count <= MOST_WRITES + self.repeats, f"{board.name}: {index:04X}h sub {sub} is written {count} times"
            )
        if found.state == OPERATIONAL and not outcome.refusals and self._is_right(board, found):
            asked = [] if found.synchronous else [w for w in seen.writes if w[1:] == (2, 1) and w[0] < 0x1600]
            told = seen.orders, [write for write in seen.writes if write not in asked]  # whether it waits for SYNC
            fell = not beats(found) and PRE not in seen.orders  # nobody had guarded it for too long
            require(told == ([], []) or fell, f"{board.name} is operational and right, and gets NMT and writes {told}")

    def _is_right(self, board: JudgedBoard, found: Found) -> bool:
        """Returns whether the last boot has left the board as it is now."""
        return found.values == self.left.get(board.name)

    def _judge_refused(self, board: JudgedBoard, found: Found, outcome: Outcome, code: str) -> None:
        """Requires that a refused board is as it was found."""
        if code == "board-missing":
            return
        look, seen = self._looks[board.name], self.seen[board.name]
        changed = {
            f"{index:04X}h sub {sub}": (value, look.number(index, sub))
            for (index, sub), value in found.values.items()
            if index not in LIVE
            and index != board.base
            and look.number(index, sub) != value
            and not (0x1600 <= index < 0x1C00 and index & 0x200 and sub > found.byte(index, 0))  # not in use
        }
        require(not changed, f"{board.name} was refused, and is changed: {changed}")
        for sub, value in outcome.outputs.items():
            now = look.number(board.base, sub)
            right = now in (found.byte(board.base, sub), value)
            require(
                right, f"{board.name} was refused: {board.base:04X}h sub {sub} is {now:02X}h, {value:02X}h is known"
            )
        unread = any(index == board.base for index, _ in found.refused)
        states = {found.state} | ({PRE_OPERATIONAL} if unread or not found.starts else set())
        now = look.state()
        require(now in states, f"{board.name} was found in {found.state}, was refused, and is in {now}; {seen.orders}")

    def _judge_ready(
        self, board: JudgedBoard, found: Found, outcome: Outcome, warnings: list[Any], timing: Any
    ) -> None:
        look, seen = self._looks[board.name], self.seen[board.name]
        require(look.state() == OPERATIONAL, f"{board.name} is told as ready, and is in {look.state()}")
        as_is, written_off = not seen.orders, False
        judge_objects(board, found, look, timing, as_is)
        for sub, value in outcome.outputs.items():
            was, now = found.byte(board.base, sub), look.number(board.base, sub)
            held = now == was and found.explained and found.state == PRE_OPERATIONAL  # as another master commanded
            written_off |= now != was
            text = f"{board.name}: {board.base:04X}h sub {sub} was {was:02X}h, is {now:02X}h"
            expected = was if as_is else value
            require(held or now == expected, f"{text}, must be {expected:02X}h; it was found in {found.state}")
        limits = [w.message for w in warnings if (w.code, w.source) == ("board-limits", board.name)]
        told = {word for word in LIMITS if limits and word in limits[0]}
        require(told == outcome.limits, f"{board.name}: warned is {limits}; {sorted(outcome.limits)} is expected")
        padded = bool(limits) and PADDED in limits[0]  # of a TPDO that has come while other boards boot
        require(padded or len(limits) == bool(outcome.limits), f"{board.name}: {limits}")
        off = [w for w in warnings if (w.code, w.source) == ("outputs-off", board.name)]
        right = len(off) == written_off or (off and board.name in self.failed)
        require(right, f"{board.name}: {off}, outputs were written off: {written_off}")
        if not as_is:
            self._judge_order(board, found)

    def _judge_order(self, board: JudgedBoard, found: Found) -> None:
        """Requires: read, write, read back; outputs before 6206h unless operational; the start at the end."""
        seen = self.seen[board.name]
        require(seen.orders.count(START) == 1, f"{board.name} gets NMT {seen.orders}")
        start = seen.log.index(("order", START, 0))
        values = [value for index, _, value in seen.writes if index == 0x6206]
        for at, (what, index, sub) in enumerate(seen.log):
            if what != "write":
                continue
            after = seen.log[at + 1 :]
            require(("read", index, sub) in after, f"{board.name}: {index:04X}h sub {sub} is not read back")
            if index == 0x6206:
                goes = values.pop(0) & board.taken >> 8 * (sub - 1)
                require(not goes or at > start, f"{board.name}: 6206h sub {sub} lets {goes:02X}h go before the start")
            late = at > start and (index not in (0x6206, 0x6207) or not board.taken)
            require(not late, f"{board.name}: {index:04X}h sub {sub} is written after the start")
            require(("read", index, sub) in seen.log[:at], f"{board.name}: {index:04X}h sub {sub} is written unread")
        places = [(0x1001, 0)] + [(board.base, sub) for sub in bytes_of(board.used)]
        for index, sub in places + [(INPUTS, sub) for sub in bytes_of(board.sensed)]:
            require(
                ("read", index, sub) in seen.log[start:], f"{board.name}: {index:04X}h sub {sub} is not read at the end"
            )

    def _judge_time(self, seconds: float, timing: Any) -> None:
        """Requires that a boot waits for nothing but heartbeats and answers."""
        busy = max(
            (count * 2 * FRAME_BITS / self._wiring.rates[bus] for bus, count in self.requests.items()), default=0.0
        )
        longest = self.allowance + 3 * busy + 8 * timing.heartbeat + 0.05
        require(seconds <= longest, f"a boot takes {seconds:.3f} s; {longest:.3f} s are enough")
