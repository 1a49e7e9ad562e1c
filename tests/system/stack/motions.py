"""Motion, read from the frames on the bus alone, and whether it was requested."""

import threading
from collections import deque
from collections.abc import Callable, Sequence

import can
import numpy as np
from numpy.typing import NDArray

from hyperbit.drivers.canopen.boards.outputs import assemble
from hyperbit.drivers.canopen.layout import lay_out
from hyperbit.drivers.canopen.wire import cia301
from hyperbit.drivers.canopen.wire.cia301 import Command, State
from hyperbit.drivers.canopen.wiring import Wiring
from hyperbit.drivers.simulation.simulation import Simulation
from tests.system.stack.observer import Observer
from tests.waiting import eventually

MASTER_LOST = bytes([0x30, 0x81])  # of an emergency
SLACK = 1.0  # [s] by which a busy machine may receive a frame later than a result


class Listener:
    """Receives all frames of a bus, in a thread as well, because a socket that nobody reads loses frames."""

    def __init__(self, bus: can.BusABC) -> None:
        self._bus, self._heard = bus, deque[can.Message | can.CanOperationError]()
        self._lock, self._over = threading.Lock(), threading.Event()
        self._thread = threading.Thread(target=self._read, name="listener", daemon=True)
        self._thread.start()

    def recv(self) -> can.Message | None:
        """Returns the next frame, None if there is none; never waits."""
        with self._lock:
            heard = self._heard.popleft() if self._heard else self._bus.recv(0)
        if isinstance(heard, can.CanOperationError):
            raise heard
        return heard

    def close(self) -> None:
        self._over.set()
        self._thread.join()

    def _read(self) -> None:
        while not self._over.wait(0.05):
            with self._lock:
                try:
                    while (frame := self._bus.recv(0)) is not None:
                        self._heard.append(frame)
                except can.CanOperationError as error:
                    self._heard.append(error)


class Motions:
    """Follows the outputs of all boards, from the frames on one bus.

    Attributes:
        outputs: (A,) the actuators' outputs.
        switched: (A,) number of switches by RPDO and SYNC.
        fell: (A,) number of switches to off with a lost board.
        moved_at: times of SYNCs that switched an output [UNIX s].
        syncs: times of all SYNCs [UNIX s].
        rows: (A,) outputs after each SYNC that switched one.
        deaf: whether the interface was removed or down, so that nothing is known.
    """

    def __init__(
        self, wiring: Wiring, listener: Listener, flush: Callable[[], None], outputs: Sequence[int] = ()
    ) -> None:
        self.listener, self._flush, self._layout = listener, flush, lay_out(wiring)
        boards = self._layout.boards
        self._frames = assemble(boards, {k: board.rpdos for k, board in enumerate(boards)})
        count = len(wiring.channels)
        self.outputs = np.array(outputs or [0] * count, dtype=np.uint8)
        self.switched, self.fell = np.zeros(count, dtype=int), np.zeros(count, dtype=int)
        self.moved_at: list[float] = []
        self.syncs: list[float] = []
        self.rows: list[NDArray[np.uint8]] = []
        self.identifiers: list[int] = []
        self.deaf = False
        self._before = np.zeros(count, dtype=int)
        self._latched: dict[int, dict[int, int]] = {}  # states by actuator, by index of the board
        self._operational = [True] * len(self._layout.boards)

    def begin(self, boards: Simulation) -> None:
        self._before = boards.switches()

    def read(self) -> None:
        """Reads the frames since the last call, all that were sent by now."""
        self._flush()
        try:
            while not self.deaf and (frame := self.listener.recv()) is not None:
                if not frame.is_error_frame:
                    self.identifiers.append(frame.arbitration_id)
                    self._take(frame.arbitration_id, bytes(frame.data), frame.timestamp)
        except can.CanOperationError:
            self.deaf = True

    def clear(self) -> None:
        self.read()
        for it in (self.moved_at, self.syncs, self.rows, self.identifiers):
            it.clear()

    def still(self) -> bool:
        self.read()
        return not self.syncs

    def agree(self, boards: Simulation) -> None:
        """Waits until the boards have switched as the frames say, which may be a moment later."""

        def same() -> bool:
            self.read()
            return (self.switched + self.fell).tolist() == (boards.switches() - self._before).tolist()

        eventually(same, told=lambda: f"{self.switched + self.fell} on the bus, {boards.switches()} of the boards")

    def check(self, client: Observer, boards: Simulation) -> None:
        """Asserts that all motion on the bus was for accepted goals, each with one result."""
        for goal in client.accepted:
            client.result(goal)
        results = [result for goal in client.accepted for result in client.results(goal)]
        assert len(results) == len(client.accepted), "each accepted goal has one result"
        self.read()
        if self.deaf:
            return
        self.agree(boards)
        spans = [*(client.span(goal) for goal in client.accepted), *client.streams]
        unasked = [stamp for stamp in self.moved_at if not any(a <= stamp <= b + SLACK for a, b in spans)]
        assert not unasked, f"the arm moved at {unasked} with no goal, those were at {spans}"
        if not client.streams:
            asked = sum(result["switches"] for result in results)
            assert self.switched.sum() == asked, "the results report as many switches as there were on the bus"

    def _take(self, cob_id: int, data: bytes, stamp: float) -> None:
        function, node = cia301.split(cob_id)
        if cob_id == cia301.NMT and len(data) == 2:
            for k, board in enumerate(self._layout.boards):
                if data[1] in (0, board.node):
                    self._set(k, data[0] == Command.START)
        elif cob_id == cia301.SYNC:
            self.sync(stamp)
        elif function == cia301.RPDO1:
            self._latch(cob_id, data)
        elif data:  # a remote frame of node guarding has none
            for k, board in enumerate(self._layout.boards):
                if board.node == node and function == cia301.HEARTBEAT:
                    self._set(k, data[0] == State.OPERATIONAL)
                    if data[0] == State.BOOT_UP:
                        mine = self._of(board.actuators)
                        self.fell[mine] += self.outputs[mine]
                        self.outputs[mine] = 0
                elif board.node == node and function == cia301.EMERGENCY and data[:2] == MASTER_LOST:
                    self._set(k, False)

    def _set(self, board: int, operational: bool) -> None:
        if operational != self._operational[board]:
            self._latched.pop(board, None)
        self._operational[board] = operational

    def _latch(self, cob_id: int, data: bytes) -> None:
        number = int.from_bytes(data, "little")
        for frame in self._frames:
            for k in frame.boards if frame.cob_id == cob_id else ():
                if self._operational[k]:
                    bits = [bit for bit in frame.bits if bit.line & self._layout.boards[k].output_lines]
                    self._latched[k] = {bit.line.bit_length() - 1: int(number & bit.place > 0) for bit in bits}

    def sync(self, stamp: float) -> None:
        self.syncs.append(stamp)
        after = self.outputs.copy()
        for states in self._latched.values():
            after[list(states)] = list(states.values())
        self._latched.clear()
        if (after != self.outputs).any():
            self.moved_at.append(stamp)
            self.rows.append(after)
        self.switched += after != self.outputs
        self.outputs = after

    def _of(self, actuators: int) -> list[int]:
        return [k for k in range(len(self.outputs)) if actuators >> k & 1]
