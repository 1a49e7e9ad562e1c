"""Boot of all boards in parallel."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from drivers.canopen.boot import boot_board
from drivers.canopen.faults import Fault
from drivers.canopen.outputs import Outputs
from drivers.canopen.station import Station
from drivers.canopen.wiring import Timing, Wiring

_MOST_REBOOTS = 5  # of one board while it is booted


class Booting:
    """Boots boards, and knows which could not be booted.

    Args:
        stations: all boards.
        outputs: takes the outputs that are read back.
        wiring: what is known of boards without an error mode.
        timing: heartbeats and boot time.
    """

    def __init__(self, stations: Sequence[Station], outputs: Outputs, wiring: Wiring, timing: Timing) -> None:
        self._stations, self._outputs = stations, outputs
        self._error_state, self._timing = wiring.error_state, timing
        self._pending: set[int] = set()  # indices of boards
        self._reboots: dict[int, int] = {}
        self._bus_faults: dict[str, Fault] = {}
        self._board_faults: dict[int, Fault] = {}

    @property
    def under_way(self) -> bool:
        """Whether a board is not booted yet."""
        return bool(self._pending)

    @property
    def faults(self) -> list[Fault]:
        """One fault for each bus, then for each board, that is not up."""
        return [*self._bus_faults.values(), *(fault for _, fault in sorted(self._board_faults.items()))]

    def begin(self, lost: Mapping[str, Fault], now: float) -> None:
        """Begins to boot all boards but those of lost buses, in place of what is under way."""
        for station in self._stations:
            station.cancel()
            station.board.forget()
        self._bus_faults, self._board_faults, self._reboots = dict(lost), {}, {}
        begun = [station for station in self._stations if station.board.layout.bus not in lost]
        self._pending = {station.index for station in begun}
        for station in begun:
            self._start(station, now)

    def rebooted(self, station: Station, now: float) -> None:
        """Boots a board again that has started anew meanwhile: what was written to it is gone."""
        if not self._pending:
            return
        i = station.index
        self._reboots[i] = self._reboots.get(i, 0) + 1
        station.cancel()
        if self._reboots[i] <= _MOST_REBOOTS:
            self._pending.add(i)
            self._board_faults.pop(i, None)
            self._start(station, now)
        else:
            name = station.board.name
            text = f"board {name} started anew {self._reboots[i]} times while it was booted: check its supply"
            self._ended(i, Fault("board-rebooted", name, text))

    def bus_lost(self, fault: Fault) -> None:
        """Gives up the boards of a bus; the fault stands for all of them."""
        if not self._pending:
            return
        self._bus_faults.setdefault(fault.source, fault)
        for station in self._stations:
            if station.board.layout.bus == fault.source:
                station.cancel()
                self._board_faults.pop(station.index, None)
                self._pending.discard(station.index)
        self._find_lost()

    def _start(self, station: Station, now: float) -> None:
        def ended(fault: Fault | None, now: float) -> None:
            self._ended(station.index, fault)

        procedure = boot_board(station.index, station.board, self._outputs, self._timing, self._error_state)
        station.runner.start(procedure, ended, now)

    def _ended(self, i: int, fault: Fault | None) -> None:
        self._pending.discard(i)
        if fault is not None:
            self._board_faults[i] = fault
        self._find_lost()

    def _find_lost(self) -> None:
        """Finds boards, at the end, that were booted and lost again while others booted."""
        if self._pending:
            return
        for station in self._stations:
            board, i = station.board, station.index
            if not board.ready and i not in self._board_faults and board.layout.bus not in self._bus_faults:
                text = f"board {board.name} was booted, and lost again while others booted: check its supply and wires"
                self._board_faults[i] = Fault("board-lost", board.name, text)
