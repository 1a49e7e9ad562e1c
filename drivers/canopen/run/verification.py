"""Verification: reads boards back while they run, to find outputs that did not switch and foreign changes."""

from __future__ import annotations

from collections.abc import Generator

from drivers.canopen.faults import ArmFault, board_error
from drivers.canopen.pdo import subs_of
from drivers.canopen.run.board import Board
from drivers.canopen.run.boards import Boards
from drivers.canopen.run.station import Station
from drivers.canopen.sdo.client import SdoOutcome, Transfer
from drivers.canopen.sdo.objects import Need, abort_words
from drivers.canopen.sdo.procedure import Step, Wait
from drivers.canopen.wire import cia301
from drivers.canopen.wire.cia301 import wire_bits

_SHARE, _SHORTEST = 0.01, 0.05  # share of the bit rate, and shortest time between two reads on one bus [s]
_ALL_WITHIN = 1.0  # [s] for the outputs of all boards of a bus after a switch
_PAUSE, _TRIES = 0.05, 8  # [s] between two reads of outputs that are not yet right, and number of reads
_PULSE_PAUSE, _PULSE_TRIES = 0.01, 2  # the same inside a pulse: as many wrong reads prove that it did not begin
_MOST_SILENT = 3  # reads in a row without a result
_MOST_MISSED = 3  # pulses in a row that were over before they were read


class Verification:
    """Reads back outputs after switches, and all objects of the boot in turn.

    Attributes:
        blocking: indices of boards without end-stops whose first switch after the boot is being read back.
        failed: why the outputs of such a board did not switch; None if they did, and from the next boot on.

    Args:
        boards: the boards.
    """

    def __init__(self, boards: Boards) -> None:
        self.blocking: set[int] = set()
        self.failed: str | None = None
        self._boards = boards
        self._unverified = set(range(len(boards.stations)))  # boards not verified since their boot
        self._pulses: set[int] = set()  # boards with a pulse that was not read back
        self._silent = [0] * len(boards.stations)  # reads in a row without a result
        self._missed = [0] * len(boards.stations)  # pulses in a row that were not read back
        self._due: dict[int, None] = {}  # boards whose outputs must be read back, the oldest first
        self._next = dict.fromkeys(boards.links, 0.0)  # time of the next read on each bus
        self._turns = dict.fromkeys(boards.links, 0)
        self._of_bus = {
            name: [station for station in boards.stations if station.board.layout.bus == name] for name in boards.links
        }
        bitrates = {name: link.wiring.bitrate for name, link in boards.links.items()}
        self._pace = {name: max(_SHORTEST, 2 * wire_bits(8) / (_SHARE * rate)) for name, rate in bitrates.items()}

    def begin(self) -> None:
        """Records that a boot of all boards has begun."""
        self._unverified = set(range(len(self._boards.stations)))
        self._due.clear()
        self._pulses.clear()
        self.blocking.clear()
        self.failed = None

    def switched(self, lines: int) -> None:
        """Records that output lines were switched."""
        for station in self._boards.stations:
            layout, i = station.board.layout, station.index
            if switched := layout.output_lines & lines:
                self._due[i] = None
                if switched & self._boards.pulsed & self._boards.outputs.states:
                    self._pulses.add(i)
                if i in self._unverified and switched & ~layout.sensed:
                    self.blocking.add(i)

    def tick(self, now: float) -> None:
        """Starts the reads that are due; `now` stands still while the loop stalls [s]."""
        stations = self._boards.stations
        for i in [i for i in self._due if not stations[i].board.ready]:
            self._end(i)
        for i in [i for i in sorted(self.blocking | self._pulses) if not stations[i].runner.running]:
            self._start(stations[i], self._outputs(stations[i]), now)
        for bus, link in self._boards.links.items():
            if not link.armed:
                continue
            due = [i for i in self._due if stations[i].board.layout.bus == bus and not stations[i].runner.running]
            pace = min(self._pace[bus], _ALL_WITHIN / len(due)) if due else self._pace[bus]
            self._next[bus] = min(self._next[bus], now + pace)
            while now >= self._next[bus]:
                self._next[bus] = max(self._next[bus] + pace, now - pace)
                if due:
                    station = stations[due.pop(0)]
                    self._start(station, self._outputs(station), now)
                else:
                    self._take_turn(bus, now)
                    break

    def _take_turn(self, bus: str, now: float) -> None:
        """Reads one object of one board: all boards in turn, and all objects of each in turn."""
        stations = self._of_bus[bus]
        if not stations:
            return
        turn = self._turns[bus]
        self._turns[bus] += 1
        station = stations[turn % len(stations)]
        board = station.board
        if not board.ready or station.runner.running:
            return
        objects_read = len(board.expected) + 2
        k = turn // len(stations) % objects_read
        if k < len(board.expected):
            self._start(station, self._object(station, board.expected[k]), now)
        elif k == len(board.expected) and board.layout.outputs:
            self._start(station, self._outputs(station), now)
        else:
            self._start(station, self._errors(station), now)

    def _start(self, station: Station, reading: Generator[Step, SdoOutcome, None], now: float) -> None:
        station.runner.start(reading, None, now)

    def _end(self, i: int) -> None:
        self._due.pop(i, None)
        self.blocking.discard(i)
        self._pulses.discard(i)

    def _outputs(self, station: Station) -> Generator[Step, SdoOutcome, None]:
        """Compares the outputs of a board with the switched levels; a board may need some time."""
        board, i, outputs = station.board, station.index, self._boards.outputs
        changes, wrong = outputs.changes[i], list[tuple[int, int]]()
        for _ in range(_TRIES):
            pulsing = bool(outputs.states & self._boards.pulsed & board.layout.output_lines)
            bits = yield from self._read(station)
            if bits is None:
                return
            if outputs.changes[i] != changes:
                break  # it was switched meanwhile: read again later
            should = outputs.bits(i)
            if bits == should:
                self._right(station, pulsing)
                return
            wrong.append((bits, should))
            yield Wait(lambda: False, _PULSE_PAUSE if pulsing else _PAUSE)
        missed = len(wrong) == _TRIES or (len(wrong) >= _PULSE_TRIES and i in self._pulses)
        if missed and board.ready:
            self._not_switched(station, *wrong[-1])

    def _read(self, station: Station) -> Generator[Step, SdoOutcome, int | None]:
        """Reads the used outputs of a board; None, and a fault the third time, if the board does not tell them."""
        board, bits = station.board, 0
        for sub in subs_of(board.layout.output_bits):
            outcome = yield Transfer(board.layout.settings.object, sub, fresh=True)
            if not outcome.data:
                self._unread(station, sub, outcome)
                return None
            bits |= outcome.data[0] << 8 * (sub - 1)
        self._silent[station.index] = 0
        return bits & board.layout.output_bits

    def _unread(self, station: Station, sub: int, outcome: SdoOutcome) -> None:
        """Counts a read without a result; it verifies nothing, so the board stays due."""
        board, i = station.board, station.index
        board.unverified += 1
        self._silent[i] += 1
        if self._silent[i] < _MOST_SILENT or not board.ready:
            return
        why = outcome.silence or f"it refuses: {abort_words(outcome.abort or 0)}"
        place = f"{board.layout.settings.object:04X}h sub {sub} (outputs)"
        text = f"board {board.name} does not let {place} be read back, {_MOST_SILENT} times in a row: {why}"
        if i in self.blocking:
            self.failed = text
        self._silent[i] = 0
        self._end(i)
        board.fail(ArmFault("not-verified", board.name, text))

    def _right(self, station: Station, pulsing: bool) -> None:
        """Records that the outputs are right; after the end of a pulse, this tells nothing of the pulse."""
        board, i = station.board, station.index
        pulsed = i in self._pulses
        self._end(i)
        if pulsing:
            self._missed[i] = 0
        if pulsing or not board.layout.output_lines & self._boards.pulsed:
            self._unverified.discard(i)
        elif pulsed:
            board.unverified += 1
            self._missed[i] += 1
            if self._missed[i] == _MOST_MISSED:
                self._unverified.discard(i)  # no commit waits for it any more
                self._warn(board)

    def _warn(self, board: Board) -> None:
        """Warns that the pulses of a board are not verified, unless end-stops tell of all of them."""
        if board.layout.output_lines & self._boards.pulsed & ~board.layout.sensed:
            text = "its pulses are too short to be read back; only end-stops tell whether its outputs follow"
            board.warnings = (*board.warnings, text)

    def _not_switched(self, station: Station, bits: int, should: int) -> None:
        board = station.board
        sub = subs_of(bits ^ should)[0]
        found, wanted = (number >> 8 * (sub - 1) & 0xFF for number in (bits, should))
        place = f"{board.layout.settings.object:04X}h sub {sub} (outputs)"
        text = (
            f"board {board.name} has {found:02X}h in {place}; {wanted:02X}h was switched: it does not follow RPDO and"
            " SYNC, or another program writes to it; reset configures it again"
        )
        if station.index in self.blocking:
            self.failed = text
        self._end(station.index)
        board.fail(ArmFault("not-switched", board.name, text))

    def _object(self, station: Station, need: Need) -> Generator[Step, SdoOutcome, None]:
        """Checks that an object still has its value from the end of the boot."""
        board = station.board
        for _ in range(2):
            outcome = yield Transfer(need.index, need.sub, fresh=True)
            if outcome.data is None or need.met(present := int.from_bytes(outcome.data[: need.size], "little")):
                return
        if board.ready:
            text = (
                f"board {board.name} has {need.words(present)} in {need.place}; {need.words(need.value)} is needed"
                " and was there: another program writes to it, or it has restarted; reset configures it again"
            )
            board.fail(ArmFault("board-changed", board.name, text))

    def _errors(self, station: Station) -> Generator[Step, SdoOutcome, None]:
        """Checks the error register, 1001h, for an error without an emergency."""
        board = station.board
        for _ in range(2):
            outcome = yield Transfer(0x1001, 0, fresh=True)
            found = (outcome.data or b"\0")[0]
            register = found & ~board.ignored_errors & ~board.emergency_register
            if not register and not (found and (yield from self._new_error(board))):
                return
            register = register or found
            yield Wait(lambda: False, 4 * _PAUSE)
        history = yield Transfer(0x1003, 1)
        text = f"error register 1001h sub 0 is {register:02X}h"
        if history.data:
            code = int.from_bytes(history.data[:2], "little")
            text += f"; 1003h sub 1 tells {cia301.emergency_words(code)}"
        if board.ready:
            board.report(board_error(board.name, text))

    def _new_error(self, board: Board) -> Generator[Step, SdoOutcome, bool]:
        """Returns whether the error history, 1003h sub 1, has a new error since the boot; an entry 0000h is an end."""
        if board.history is None or board.emergency is not None:
            return False
        outcome = yield Transfer(0x1003, 1, fresh=True)
        newest = int.from_bytes(outcome.data[:4], "little") if outcome.data else board.history
        return newest != board.history and bool(newest & 0xFFFF)
