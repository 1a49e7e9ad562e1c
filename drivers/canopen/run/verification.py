"""Verification: reads boards back while they run, to find outputs that did not switch and foreign changes."""

from __future__ import annotations

from collections.abc import Generator

from drivers.canopen.faults import Fault
from drivers.canopen.pdo import subs_of
from drivers.canopen.run.network import Network
from drivers.canopen.run.station import Station
from drivers.canopen.sdo.client import Outcome, Transfer
from drivers.canopen.sdo.objects import Need
from drivers.canopen.sdo.procedure import Step, Wait
from drivers.canopen.wire import cia301
from drivers.canopen.wire.cia301 import wire_bits

_SHARE, _SHORTEST = 0.01, 0.05  # share of the bit rate, and shortest time between two reads on one bus [s]
_ALL_WITHIN = 1.0  # [s] for the outputs of all boards of a bus after a switch
_PAUSE, _TRIES = 0.05, 8  # [s] between two reads of outputs that are not yet right, and number of reads


class Verification:
    """Reads back outputs after switches, and all objects of the boot in turn.

    Attributes:
        blocking: indices of boards without end-stops whose first switch after the boot is being read back.
        failed: why the outputs of such a board did not switch; None if they did.

    Args:
        network: the boards.
    """

    def __init__(self, network: Network) -> None:
        self.blocking: set[int] = set()
        self.failed: str | None = None
        self._network = network
        self._unverified = set(range(len(network.stations)))  # boards not verified since their boot
        self._due: dict[int, None] = {}  # boards whose outputs must be read back, the oldest first
        self._next = dict.fromkeys(network.links, 0.0)  # time of the next read on each bus
        self._turns = dict.fromkeys(network.links, 0)
        self._of_bus = {
            name: [station for station in network.stations if station.board.layout.bus == name]
            for name in network.links
        }
        bitrates = {name: link.settings.bitrate for name, link in network.links.items()}
        self._pace = {name: max(_SHORTEST, 2 * wire_bits(8) / (_SHARE * rate)) for name, rate in bitrates.items()}

    def begin(self) -> None:
        """Records that a boot of all boards has begun."""
        self._unverified = set(range(len(self._network.stations)))
        self._due.clear()
        self.blocking.clear()
        self.failed = None

    def switched(self, lines: int) -> None:
        """Records that output lines were switched."""
        for station in self._network.stations:
            layout, i = station.board.layout, station.index
            if switched := layout.output_lines & lines:
                self._due[i] = None
                if i in self._unverified and switched & ~layout.sensed:
                    self.blocking.add(i)

    def tick(self, now: float) -> None:
        """Starts the reads that are due; `now` stands still while the loop stalls [s]."""
        stations = self._network.stations
        for i in [i for i in self._due if not stations[i].board.ready]:
            self._end(i)
        for i in [i for i in self.blocking if not stations[i].runner.running]:
            self._start(stations[i], self._outputs(stations[i]), now)
        for bus, link in self._network.links.items():
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

    def _start(self, station: Station, reading: Generator[Step, Outcome, None], now: float) -> None:
        station.runner.start(reading, lambda fault, now: None, now)

    def _end(self, i: int) -> None:
        self._due.pop(i, None)
        self.blocking.discard(i)

    def _outputs(self, station: Station) -> Generator[Step, Outcome, None]:
        """Compares the outputs of a board with the switched levels; a board may need some time."""
        board, i = station.board, station.index
        layout, outputs = board.layout, self._network.outputs
        for _ in range(_TRIES):
            changes, bits = outputs.changes[i], 0
            for sub in subs_of(layout.output_bits):
                outcome = yield Transfer(layout.settings.object, sub, fresh=True)
                if not outcome.data:  # its heartbeats tell whether the board is there
                    self._end(i)
                    return
                bits |= outcome.data[0] << 8 * (sub - 1)
            if outputs.changes[i] != changes:
                return  # it was switched meanwhile: read again later
            should = outputs.bits(i)
            if bits & layout.output_bits == should:
                self._end(i)
                self._unverified.discard(i)
                return
            yield Wait(lambda: False, _PAUSE)
        if outputs.changes[i] == changes and board.ready:
            self._not_switched(station, bits & layout.output_bits, should)

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
        board.fail(Fault("not-switched", board.name, text))

    def _object(self, station: Station, need: Need) -> Generator[Step, Outcome, None]:
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
            board.fail(Fault("board-changed", board.name, text))

    def _errors(self, station: Station) -> Generator[Step, Outcome, None]:
        """Checks the error register, 1001h, for an error without an emergency."""
        board = station.board
        for _ in range(2):
            outcome = yield Transfer(0x1001, 0, fresh=True)
            register = (outcome.data or b"\0")[0] & ~board.ignored_errors
            if not register or board.emergency is not None:
                return
            yield Wait(lambda: False, 4 * _PAUSE)
        history = yield Transfer(0x1003, 1)
        text = f"error register 1001h sub 0 is {register:02X}h"
        if history.data:
            code = int.from_bytes(history.data[:2], "little")
            text += f"; 1003h sub 1 tells {cia301.emergency_words(code)}"
        if board.ready:
            text = f"board {board.name} reports an error: {text}. Remove its cause, then reset"
            board.report(Fault("board-error", board.name, text))
