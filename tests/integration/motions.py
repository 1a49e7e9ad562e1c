"""What moved, told from the frames alone, and whether a goal asked for it."""

import can
import numpy as np
from numpy.typing import NDArray

from drivers import cia301
from drivers.cia301 import Command, State
from drivers.layout import lay_out
from drivers.simulation.simulation import Simulation
from drivers.wiring import Wiring
from tests.daemon.waiting import eventually
from tests.integration.harness import Observer

MASTER_LOST = bytes([0x30, 0x81])  # of an emergency


class Motions:
    """Follows the outputs of all boards as the frames on the bus switch them.

    Attributes:
        outputs: (A,) the actuators' outputs.
        switched: (A,) how often each was switched by RPDO and SYNC.
        fell: (A,) how often each fell off with its board.
        moved_at: when a SYNC switched any, UNIX seconds.
        rows: (A,) outputs after each of those.
    """

    def __init__(self, wiring: Wiring, listener: can.BusABC, outputs: NDArray[np.uint8] | None = None) -> None:
        self._listener, self._layout = listener, lay_out(wiring)
        count = len(wiring.channels)
        self.outputs = np.zeros(count, dtype=np.uint8) if outputs is None else outputs.astype(np.uint8)
        self.switched, self.fell = np.zeros(count, dtype=int), np.zeros(count, dtype=int)
        self.moved_at: list[float] = []
        self.rows: list[NDArray[np.uint8]] = []
        self._latched: dict[int, bytes] = {}  # of boards by their index
        self._operational = [True] * len(self._layout.boards)

    def read(self) -> None:
        """Takes in what was on the bus since the last call."""
        while (frame := self._listener.recv(0)) is not None:
            if not frame.is_error_frame:
                self._take(frame.arbitration_id, bytes(frame.data), frame.timestamp)

    def check(self, client: Observer, boards: Simulation) -> None:
        """Sees that all that moved was switched from the bus while and as accepted goals asked, of one result each."""
        for goal in client.accepted:
            client.result(goal)

        def agree() -> bool:  # the boards may be a moment behind the frames
            self.read()
            return (self.switched + self.fell).tolist() == boards.switches().tolist()

        eventually(agree)
        results = [result for goal in client.accepted for result in client.results(goal)]
        assert len(results) == len(client.accepted), "each accepted goal has one result"
        asked = sum(result["switches"] for result in results)
        spans = [client.span(goal) for goal in client.accepted]
        unasked = [stamp for stamp in self.moved_at if not any(a <= stamp <= b for a, b in spans)]
        assert not unasked, f"the arm moved at {unasked} with no goal, those were at {spans}"
        assert self.switched.sum() == asked, "what was switched on the bus is what the goals' results tell"

    def _take(self, cob_id: int, data: bytes, stamp: float) -> None:
        function, node = cia301.split(cob_id)
        if cob_id == cia301.NMT and len(data) == 2:
            for k, board in enumerate(self._layout.boards):
                if data[1] in (0, board.node):
                    self._set(k, data[0] == Command.START)
        elif cob_id == cia301.SYNC:
            self._sync(stamp)
        elif function == cia301.RPDO1:
            self._latch(cob_id, data)
        else:
            for k, board in enumerate(self._layout.boards):
                if board.node == node and function == cia301.HEARTBEAT:
                    self._set(k, data[0] == State.OPERATIONAL)
                    if data[0] == State.BOOT_UP:
                        mine = self._layout.board == k
                        self.fell += mine & (self.outputs == 1)
                        self.outputs[mine] = 0
                elif board.node == node and function == cia301.EMERGENCY and data[:2] == MASTER_LOST:
                    self._set(k, False)

    def _set(self, board: int, operational: bool) -> None:
        if operational != self._operational[board]:
            self._latched.pop(board, None)
        self._operational[board] = operational

    def _latch(self, cob_id: int, data: bytes) -> None:
        starts = {frame.cob_id: frame.image.start for frame in self._layout.frames}
        for k, board in enumerate(self._layout.boards):
            if board.rpdo == cob_id and self._operational[k]:
                start = starts[cob_id]
                self._latched[k] = data[board.image.start - start : board.image.stop - start]

    def _sync(self, stamp: float) -> None:
        layout, after = self._layout, self.outputs.copy()
        for k, data in self._latched.items():
            mine = np.flatnonzero(layout.board == k)
            image = np.frombuffer(data, np.uint8)[layout.byte[mine] - layout.boards[k].image.start]
            after[mine] = image >> layout.bit[mine] & 1
        self._latched.clear()
        if (after != self.outputs).any():
            self.moved_at.append(stamp)
            self.rows.append(after)
        self.switched += after != self.outputs
        self.outputs = after
