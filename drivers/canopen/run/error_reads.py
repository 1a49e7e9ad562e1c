"""Reads the errors of boards on request, while the boards run."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial

from hyperbit.drivers.canopen.boards.board import Board
from hyperbit.drivers.canopen.faults import ArmFault
from hyperbit.drivers.canopen.run.commit import BusCommit
from hyperbit.drivers.canopen.sdo import errors
from hyperbit.drivers.canopen.sdo.dictionary import Dictionary
from hyperbit.drivers.canopen.sdo.errors import Errors
from hyperbit.drivers.canopen.sdo.procedure import Procedure


class ErrorReads:
    """Reads registers and histories of errors.

    A reading begins when nothing else is asked of its board, and yields to reads of outputs; then it begins again.
    """

    def __init__(self, boards: Sequence[Board], commits: Mapping[str, BusCommit]) -> None:
        self._boards, self._commits = boards, commits
        self._asked: set[int] = set()  # indices of boards
        self._done: list[tuple[int, Errors | ArmFault]] = []

    def ask(self, board: int) -> None:
        """Asks a board for its errors; see `drain`."""
        self._asked.add(board)

    def drain(self) -> list[tuple[int, Errors | ArmFault]]:
        """Returns the errors that were read since the last call, by index of the board, or why they were not."""
        done, self._done = self._done, []
        return done

    def tick(self, now: float) -> None:
        """Starts the readings that are due. Call every period, but not during a boot."""
        for i in tuple(self._asked):
            board = self._boards[i]
            commit = self._commits[board.layout.bus]
            if not board.link.usable:
                text = f"board {board.name} cannot be asked: {board.link.name} is {board.link.state}"
                self._end(i, ArmFault("bus-down", board.name, text))
            elif board.stopped:
                text = f"board {board.name} is stopped and answers no SDO: reset makes it answer"
                self._end(i, ArmFault("board-stopped", board.name, text))
            elif not board.runner.running and not commit.under_way:
                board.runner.start(self._read(board), partial(self._failed, i), now, yields=True)

    def _read(self, board: Board) -> Procedure:
        it = Dictionary(board.name)
        register = yield from errors.read_register(it)
        self._end(board.index, (yield from errors.read_history(it, register)))

    def _failed(self, i: int, fault: ArmFault | None, now: float) -> None:
        if fault is not None:
            self._end(i, fault)

    def _end(self, i: int, result: Errors | ArmFault) -> None:
        self._asked.discard(i)
        self._done.append((i, result))
