"""Reads running boards: outputs that did not switch, foreign changes, and inputs whose TPDO was lost."""

from __future__ import annotations

import math
from collections.abc import Generator, Iterable, Mapping, Sequence
from dataclasses import dataclass

from hyperbit.drivers.canopen.boards.board import Board
from hyperbit.drivers.canopen.boards.outputs import OutputLines
from hyperbit.drivers.canopen.faults import board_error
from hyperbit.drivers.canopen.pdo import subs_of, union
from hyperbit.drivers.canopen.run.commit import BusCommit
from hyperbit.drivers.canopen.sdo.client import SdoOutcome, Transfer
from hyperbit.drivers.canopen.sdo.dictionary import Dictionary
from hyperbit.drivers.canopen.sdo.errors import read_history
from hyperbit.drivers.canopen.sdo.objects import Need, abort_words
from hyperbit.drivers.canopen.sdo.procedure import Step, Wait
from hyperbit.drivers.canopen.wire.cia301 import wire_bits
from hyperbit.drivers.canopen.wire.link import Link
from hyperbit.drivers.canopen.wiring import Wiring

_SHARE, _SHORTEST = 0.01, 0.05  # share of the bit rate, and shortest time between two reads on one bus [s]
_ALL_WITHIN = 1.0  # [s] for the outputs of all boards of a bus after a switch
_ANSWER = 0.1  # [s] for one answer; longer for a board that answers slowly
_PAUSE, _TRIES = 0.05, 8  # [s] between two reads of outputs that are not yet right, and number of reads
_PULSE_PAUSE, _PULSE_TRIES = 0.01, 2  # the same inside a pulse: so many wrong reads prove that it did not begin
_MOST_SILENT = 3  # successive reads without a result
_MOST_MISSED = 3  # successive pulses that ended before their read
_INPUTS_EVERY = 1.5  # [s] between two reads of the inputs; with the answer, a lost TPDO is noticed within 2 s
_POLLED_EVERY, _POLLED_SHARE = 0.25, 0.1  # [s] for watched objects without a TPDO, and their share of the bit rate

Reads = Generator[Step, SdoOutcome, None]


@dataclass
class OutputReads:
    """What the reads of one board's outputs have shown since a boot has begun."""

    silent: int = 0  # successive reads without a result, while the board sends other frames
    heard: int = 0  # number of the board's frames at the last of them
    wrong: int = 0  # number of wrong reads since the last change of `stays`
    stays: int = 0  # lines that were read wrong, and have had the same level since
    levels: int = 0  # their levels
    missed: int = 0  # successive pulses that were not read back, although the board answers
    pause: float = 0.0  # until the next read [s]
    next: float = 0.0  # time of this read [s]
    asked_at: float = 0.0  # time of the last read [s]


class Verification:
    """Reads outputs back after each switch, and all objects of the boot in turn.

    A board is read at once if no end-stop shows whether it follows, or if a pulse has ended. If the end of a pulse is
    not read back, the line is switched off again, also on a board that is not ready. Boards of a bus that is switching
    are read afterwards.
    """

    def __init__(self, boards: Sequence[Board], outputs: OutputLines, commits: Mapping[str, BusCommit]) -> None:
        self._boards, self._outputs, self._commits = boards, outputs, commits
        self._next = dict.fromkeys(commits, 0.0)  # time of the next paced read on each bus
        self._turns = dict.fromkeys(commits, 0)
        self._of_bus = {bus: [board for board in boards if board.layout.bus == bus] for bus in commits}
        self.begin()

    def begin(self) -> None:
        """Records that a boot of all boards has begun."""
        self._reads = [OutputReads() for _ in self._boards]
        self._outputs.unanswered = 0

    def tick(self, now: float) -> None:
        """Starts the reads that are due; `now` stands still while the loop stalls [s]."""
        outputs = self._outputs
        released = outputs.released
        hurried = outputs.unread & (outputs.blind | outputs.pulsed | union(reads.stays for reads in self._reads))
        for bus, commit in self._commits.items():
            if not commit.link.usable or commit.under_way:
                continue
            due = [board for board in self._of_bus[bus] if self._due(board, now)]
            for board in due:
                if lines := board.layout.output_lines & (hurried if board.ready else released):
                    board.runner.start(self._read_outputs(board, lines), None, now)
            due = [board for board in due if not board.runner.running and board.ready]
            if commit.link.armed:
                self._read_slowly(commit.link, sorted(due, key=lambda board: self._reads[board.index].asked_at), now)

    def _read_slowly(self, link: Link, due: list[Board], now: float) -> None:
        """Reads boards with end-stops, and then all objects in turn, at a slow pace."""
        bus, pace = link.name, max(_SHORTEST, 2 * wire_bits(8) / (_SHARE * link.wiring.bitrate))
        if due:
            pace = min(pace, _ALL_WITHIN / len(due))
        self._next[bus] = min(self._next[bus], now + pace)
        while now >= self._next[bus]:
            self._next[bus] = max(self._next[bus] + pace, now - pace)
            if not due:
                self._take_turn(bus, now)
                break
            board = due.pop(0)
            self._reads[board.index].asked_at = now
            board.runner.start(self._read_outputs(board, self._outputs.unread), None, now)

    def _due(self, board: Board, now: float) -> bool:
        reads = self._reads[board.index]
        if reads.pause:
            reads.next, reads.pause = now + reads.pause, 0.0
        unread = board.layout.output_lines & self._outputs.unread
        return bool(unread) and now >= reads.next and not board.runner.busy

    def _take_turn(self, bus: str, now: float) -> None:
        """Reads one object of one board: all boards in turn, and all objects of each in turn."""
        if not (boards := self._of_bus[bus]):
            return
        k, place = divmod(self._turns[bus], len(boards))
        self._turns[bus] += 1
        board = boards[place]
        if not board.ready or board.runner.running or now >= board.poll_due:
            return
        k %= len(board.expected) + 2
        if k < len(board.expected):
            reads = self._object(board, board.expected[k])
        elif k == len(board.expected) and board.layout.outputs:
            reads = self._read_outputs(board)
        else:
            reads = self._errors(board)
        board.runner.start(reads, None, now)

    def _read_outputs(self, board: Board, lines: int = -1) -> Reads:
        """Reads the output bytes that have some of the lines, and compares each with the switched levels."""
        for sub in subs_of(union(bit.place for bit in board.layout.outputs if bit.line & lines)):
            self._outputs.begin_read(board.index)
            outcome = yield Transfer(board.layout.settings.object, sub, timeout=_ANSWER, fresh=True)
            if not outcome.data:
                self._unread(board, sub, outcome)
                return
            self._compare(board, sub, outcome.data[0])

    def _compare(self, board: Board, sub: int, found: int) -> None:
        reads, outputs = self._reads[board.index], self._outputs
        reads.silent = 0
        self._count_missed(board, reads)
        released, off = outputs.released & ~reads.stays, outputs.pulsed & ~outputs.commanded
        right, wrong = outputs.read(board.index, sub, found)
        if right & outputs.pulsed & outputs.commanded:
            reads.missed = 0
        outputs.mistrust(wrong & off)
        outputs.missed |= wrong & off & ~released  # another program has switched it on
        reads.pause = (_PULSE_PAUSE if wrong & outputs.pulsed & ~off else _PAUSE) if wrong else 0.0
        wrong &= ~released
        # Counts a wrong read. Only a different level than at an earlier wrong read shows that a line follows late.
        levels = outputs.commanded ^ wrong
        reads.stays = reads.stays & ~((right | wrong) & (levels ^ reads.levels)) | wrong
        reads.levels = reads.levels & ~wrong | levels & wrong
        reads.wrong = (reads.wrong if reads.stays else 0) + bool(wrong)
        most = _PULSE_TRIES if wrong & outputs.pulsed else _TRIES
        if wrong and reads.wrong >= most and board.ready:
            used, should = (
                bits >> 8 * (sub - 1) & 0xFF for bits in (board.layout.output_bits, outputs.bits(board.index))
            )
            text = f"board {board.name} has {found & used:02X}h in {_place(board, sub)}; {should:02X}h was switched"
            cause = "it does not follow RPDO and SYNC, or another program writes to it; reset configures it again"
            self._fail(board, "not-switched", f"{text}: {cause}")

    def _count_missed(self, board: Board, reads: OutputReads) -> None:
        """Counts a missed pulse when the board answers: one that was unplugged in the pulse will be lost."""
        missed = board.layout.output_lines & self._outputs.unanswered
        if not missed:
            return
        self._outputs.unanswered &= ~missed
        board.unverified += 1
        reads.missed += bool(missed & self._outputs.blind)
        if reads.missed == _MOST_MISSED:
            text = f"pulses of board {board.name} were over {_MOST_MISSED} times before they were read back"
            advice = "give longer pulses or end-stops, or verify: false in boards.nodes"
            self._fail(board, "not-verified", f"{text}: {advice}")

    def _unread(self, board: Board, sub: int, outcome: SdoOutcome) -> None:
        """Counts a read without a result. It verifies nothing, so the board stays due. A silent board will be lost."""
        reads = self._reads[board.index]
        self._outputs.mistrust(board.layout.output_lines & self._outputs.released)
        reads.pause = _PAUSE
        board.unverified += 1
        reads.silent += outcome.silence is None or board.frames > reads.heard
        reads.heard = board.frames
        if reads.silent >= _MOST_SILENT and board.ready:
            why = outcome.silence or f"it refuses: {abort_words(outcome.abort or 0)}"
            what = f"does not let {_place(board, sub)} be read back, {_MOST_SILENT} times in a row"
            self._fail(board, "not-verified", f"board {board.name} {what}: {why}")

    def _fail(self, board: Board, code: str, text: str) -> None:
        reads = self._reads[board.index]
        reads.silent = reads.wrong = reads.stays = reads.missed = 0
        board.fail(code, text)

    def _object(self, board: Board, need: Need) -> Reads:
        """Checks that an object still has its value from the end of the boot."""
        for _ in range(2):
            outcome = yield Transfer(need.index, need.sub, fresh=True)
            if outcome.data is None or need.met(present := int.from_bytes(outcome.data[: need.size], "little")):
                return
        if board.ready:
            has, needed = need.words(present), need.words(need.value)
            text = f"board {board.name} has {has} in {need.place}; {needed} is needed and was there"
            cause = "another program writes to it, or it has restarted; reset configures it again"
            board.fail("board-changed", f"{text}: {cause}")

    def _errors(self, board: Board) -> Reads:
        """Checks the error register, 1001h, for an error without an emergency."""
        for _ in range(2):
            outcome = yield Transfer(0x1001, 0, fresh=True)
            found = (outcome.data or b"\0")[0]
            register = found & ~board.ignored_errors & ~board.emergency_register
            if found and not register and board.history is not None and board.emergency is None:
                outcome = yield Transfer(0x1003, 1, fresh=True)
                newest = int.from_bytes(outcome.data[:4], "little") if outcome.data else board.history
                if newest != board.history and newest & 0xFFFF:  # new since the boot; 0000h is an end
                    register = found
            if not register:
                return
            yield Wait(lambda: False, 4 * _PAUSE)
        errors = yield from read_history(Dictionary(board.name), register)
        if board.ready:
            board.report(board_error(board.name, errors.words(board.emergency)))


def _place(board: Board, sub: int) -> str:
    return f"{board.layout.settings.object:04X}h sub {sub} (outputs)"


class InputWatch:
    """Asks each ready board for its inputs, 6000h, and its watched objects, by SDO. A newer TPDO wins over an answer.

    A board with an input line of `interlocks` is asked every 1.5 s. 126 such boards with one byte each take 126 x 2 x
    135 bits in 1.5 s: 22.7 kbit/s, 18 % of 125 kbit/s. Other boards are asked as often, but with at most 1 % of the bit
    rate. Watched objects are asked every 1.5 s; without a TPDO every 0.25 s, or as often as 10 % of the bit rate allow.
    """

    def __init__(self, boards: Sequence[Board], links: Iterable[Link], wiring: Wiring) -> None:
        self._boards = boards
        guarded = {lock.line.board for lock in wiring.interlocks if lock.watched is None}
        self._periods: dict[int, float] = {}
        self._polled_periods: dict[int, float] = {}  # of boards with watched objects
        for link in links:
            here = [b for b in self._boards if b.link is link]
            guards = {b.index for b in here if (b.layout.bus, b.layout.node) in guarded}
            polls = 2 * wire_bits(8) * sum(len(b.layout.watched) for b in here) / (_POLLED_SHARE * link.wiring.bitrate)
            period = min(max(polls, _POLLED_EVERY), _INPUTS_EVERY)
            self._polled_periods |= {b.index: period for b in here if b.layout.watched}
            transfers = sum(len(subs_of(b.layout.input_bits)) for b in here if b.index not in guards)
            shared = transfers * 2 * wire_bits(8) / (_SHARE * link.wiring.bitrate)
            self._periods |= {b.index: _INPUTS_EVERY if b.index in guards else max(_INPUTS_EVERY, shared) for b in here}
        self._due: dict[int, float] = {}

    def begin(self, now: float) -> None:
        """Records that a boot has begun. The boot reads all inputs; later reads are spread over their periods."""
        count = len(self._boards)
        self._due = {b.index: now + self._periods[b.index] * (k + 1) / count for k, b in enumerate(self._boards)}
        for i, period in self._polled_periods.items():
            self._boards[i].poll_due = now + period * (i + 1) / count

    def tick(self, now: float) -> None:
        """Asks the boards that are due. A board with a running procedure is asked after it. Call every period."""
        for board in self._boards:
            if now >= self._due.get(board.index, now) and board.ready and not board.runner.running:
                self._due[board.index] = now + self._periods[board.index]
                board.question(now)
            if now >= board.poll_due and board.ready and not board.runner.running:
                board.poll(now, self._polled_periods[board.index] if board.polled else _INPUTS_EVERY)

    def hurry(self, bus: str, now: float) -> None:
        """Makes all ready boards of a bus due: their TPDOs may be lost."""
        here = [board for board in self._boards if board.link.name == bus]
        self._due |= {board.index: now for board in here}
        for board in here:
            board.poll_due = now if board.layout.watched else math.inf
