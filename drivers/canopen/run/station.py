"""A board, the procedures that run with it, and questions for its inputs and its presence."""

from __future__ import annotations

from hyperbit.drivers.canopen.faults import ArmFault
from hyperbit.drivers.canopen.pdo import subs_of
from hyperbit.drivers.canopen.run.board import Board
from hyperbit.drivers.canopen.sdo.client import Transfer
from hyperbit.drivers.canopen.sdo.procedure import Procedure, Runner
from hyperbit.drivers.canopen.wire.link import Link

_INPUT_TIMEOUT = 0.3  # [s] for the inputs


class Station:
    """One board on its bus.

    Attributes:
        index: index of the board.
        board: the state of the board.
        runner: runs procedures with it.
        questioning: whether a question for its inputs waits for the answer.
    """

    def __init__(self, index: int, board: Board, link: Link) -> None:
        self.index, self.board = index, board
        self.runner = Runner(board.layout.node, link)
        self.questioning = False
        self._again = False

    def cancel(self) -> None:
        """Cancels the running procedure."""
        self.runner.cancel()
        self.questioning = self._again = False

    def question(self, now: float) -> None:
        """Asks for the inputs; asks again after a running question, whose answer may be too old."""
        if self.questioning:
            self._again = True
        elif self.board.ready and self.board.layout.inputs:
            self.questioning, self._again = True, False
            self.runner.start(_ask_inputs(self.board), self._answered, now)

    def probe(self, now: float) -> None:
        """Asks for the device type, 1000h; any answer shows that the board is back."""
        if not self.runner.running:
            self.runner.start(_ask_presence(), None, now)

    def _answered(self, fault: ArmFault | None, now: float) -> None:
        self.questioning = False
        if self._again:
            self.question(now)


def _ask_inputs(board: Board) -> Procedure:
    before = board.input_frames
    for sub in subs_of(board.layout.input_bits):
        outcome = yield Transfer(0x6000, sub, timeout=_INPUT_TIMEOUT, tries=2, fresh=True)
        if outcome.data and board.input_frames == before:  # otherwise a TPDO has brought newer values
            board.set_input(sub, outcome.data[0])


def _ask_presence() -> Procedure:
    yield Transfer(0x1000, 0, tries=1)
