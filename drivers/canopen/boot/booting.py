"""The boot of all boards in parallel."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial

from hyperbit.drivers.canopen.boards.board import Board
from hyperbit.drivers.canopen.boards.outputs import OutputLines
from hyperbit.drivers.canopen.boot.board_boot import boot_board
from hyperbit.drivers.canopen.faults import ArmFault
from hyperbit.drivers.canopen.wiring import Timing

_MOST_REBOOTS = 5  # restarts of one board during its boot


class Booting:
    """Boots all boards, and collects their faults."""

    def __init__(self, boards: Sequence[Board], outputs: OutputLines, timing: Timing) -> None:
        self._boards, self._outputs = boards, outputs
        self._timing = timing
        self._pending: set[int] = set()  # indices of boards
        self._reboots: dict[int, int] = {}
        self._bus_faults: dict[str, ArmFault] = {}
        self._board_faults: dict[int, ArmFault] = {}

    @property
    def under_way(self) -> bool:
        return bool(self._pending)

    @property
    def faults(self) -> list[ArmFault]:
        """One fault for each lost bus, then one for each board that could not be booted."""
        return [*self._bus_faults.values(), *(fault for _, fault in sorted(self._board_faults.items()))]

    def begin(self, lost: Mapping[str, ArmFault], now: float) -> None:
        """Starts the boot of all boards, except those on lost buses. A running boot is cancelled."""
        for board in self._boards:
            board.cancel()
            board.forget()
        self._bus_faults, self._board_faults, self._reboots = dict(lost), {}, {}
        begun = [board for board in self._boards if board.layout.bus not in lost]
        self._pending = {board.index for board in begun}
        for board in begun:
            self._start(board, now)

    def rebooted(self, board: Board, now: float) -> None:
        """Boots a board again after a restart during its boot: the configuration is lost."""
        if not self._pending:
            return
        i = board.index
        self._reboots[i] = self._reboots.get(i, 0) + 1
        board.cancel()
        if self._reboots[i] <= _MOST_REBOOTS:
            self._pending.add(i)
            self._board_faults.pop(i, None)
            self._start(board, now)
        else:
            text = f"board {board.name} restarted {self._reboots[i]} times during its boot: check its supply"
            self._ended(i, ArmFault("board-rebooted", board.name, text), now)

    def bus_lost(self, fault: ArmFault) -> None:
        """Cancels the boot of all boards of a bus; the fault of the bus replaces theirs."""
        if not self._pending:
            return
        self._bus_faults.setdefault(fault.source, fault)
        for board in self._boards:
            if board.layout.bus == fault.source:
                board.cancel()
                self._board_faults.pop(board.index, None)
                self._pending.discard(board.index)
        self._find_lost()

    def _start(self, board: Board, now: float) -> None:
        procedure = boot_board(board, self._outputs, self._timing)
        board.runner.start(procedure, partial(self._ended, board.index), now)

    def _ended(self, i: int, fault: ArmFault | None, now: float) -> None:
        self._pending.discard(i)
        if fault is not None:
            self._board_faults[i] = fault
        self._find_lost()

    def _find_lost(self) -> None:
        """Finds, at the end, boards that were booted and then lost while others booted."""
        if self._pending:
            return
        for board in self._boards:
            i = board.index
            if not board.ready and i not in self._board_faults and board.layout.bus not in self._bus_faults:
                text = f"board {board.name} was lost again while other boards booted: check its supply and wires"
                self._board_faults[i] = ArmFault("board-lost", board.name, text)
