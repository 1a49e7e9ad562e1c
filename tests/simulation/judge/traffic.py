"""Traffic: heartbeats, polls and SDO requests of the executor, as the drivers' page promises them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

from tests.simulation.judge.account import Account
from tests.simulation.judge.verdict import require

TICK = 0.01  # [s], period of the executor's loop
LATE = 2.5 * TICK  # [s] from the time when a frame is due to the tick that sends it, behind other events
NMT, SYNC, HEARTBEAT, GUARDING = 0x000, 0x080, 0x77F, 0x700
SDO_REQUEST, REMOTE = 0x600, 1 << 30
OUTPUTS, INPUTS = 0x6200, 0x6000
READ_BACK = 1.4  # [s] after a switch until the outputs of a board are read: about a second, behind another read
INPUTS_EVERY = 1.5  # [s] between two reads of the inputs of a board
SHARE = 0.01  # of the bit rate, for reads of inputs of boards without interlocks, and for reads of all other objects
FRAME_BITS = 135  # of a CAN frame with 8 bytes and all stuff bits
PACE = 0.05  # [s], shortest time between two reads of other objects
PULSE_READS = 12  # SDO requests of one board for one switch: eight reads, and those inside a pulse
OPERATIONAL = 5


class Look(NamedTuple):
    """What the world shows of one board: an object's value, whether it has the object, and its NMT state."""

    number: Callable[[int, int], int]
    has: Callable[[int], bool]
    state: Callable[[], Any]


class Traffic:
    """Judges the frames that the executor hands out, without SYNC and RPDOs.

    Attributes:
        look: the boards by name; the world sets it.
        ordered: NMT state of each board before the first NMT command to it.
    """

    def __init__(self, account: Account, arm: Any) -> None:
        self.look: dict[str, Look] = {}
        self.ordered: dict[str, Any] = {}
        self._a, wiring = account, arm.wiring
        self._period = arm.timing.heartbeat
        self._rates = {bus.name: bus.bitrate for bus in wiring.buses}
        self._inputs: dict[str, set[int]] = {}  # of each board, bytes of its used inputs
        self._guards: set[str] = set()  # boards with interlocks
        for line in wiring.input_lines:
            if line is not None:
                self._inputs.setdefault(f"{line.bus}/{line.node}", set()).add(line.bit // 8)
        for lock in wiring.interlocks:
            self._guards.add(f"{lock.bus}/{lock.node}")
        self._objects = {f"{node.bus}/{node.node}": node.object for node in wiring.nodes}
        self._unverified = {f"{node.bus}/{node.node}" for node in wiring.nodes if not node.verify}
        self._outputs = {f"{line.bus}/{line.node}" for line in wiring.output_lines}
        self.begin()

    def begin(self) -> None:
        a = self._a
        self._beats: dict[str, float] = {}  # of each bus
        self._polls: dict[str, float] = {}  # of each guarded board
        self._input_reads: dict[str, float] = {}
        self._output_reads: dict[str, float] = {}
        self._asked: dict[str, list[float]] = {}  # times of the SDO requests on each bus since the window began
        self._window = self._began = a.now
        self.ordered = {}
        states = {name: look.state() for name, look in self.look.items()}
        self._kept = {name for name, state in states.items() if state == OPERATIONAL} if a.clear else set()

    @property
    def _runs(self) -> bool:
        a = self._a
        return a.clear and a.mode in ("ready", "executing") and a.now > a.ready_at

    def period_of(self, board: str) -> float:
        """Returns the longest time between two reads of the inputs of a board [s]."""
        if board in self._guards:
            return INPUTS_EVERY
        bus = board.split("/")[0]
        transfers = sum(
            len(used) for name, used in self._inputs.items() if name.startswith(f"{bus}/") and name not in self._guards
        )
        return max(INPUTS_EVERY, transfers * 2 * FRAME_BITS / (SHARE * self._rates[bus]))

    def hands_out(self, bus: str, cob_id: int, data: bytes) -> None:
        a = self._a
        if cob_id == HEARTBEAT:
            require(data == b"\x05", f"{bus}: the heartbeat of the executor has the data {data.hex()}")
            before = self._beats.get(bus)
            early = before is not None and a.now - before < self._period - TICK
            require(not (early and a.clear), f"{bus}: a heartbeat comes {a.now - (before or 0):g} s after another one")
            self._beats[bus] = a.now
        elif cob_id & REMOTE:
            self._poll(f"{bus}/{cob_id & 0x7F}", cob_id & 0x780)
        elif cob_id == NMT:
            require(not self._runs, f"{bus}: an NMT command {data.hex()} in mode {a.mode}")
            board = f"{bus}/{data[1]}"
            require(board in self.look, f"{bus}: an NMT command for node {data[1]}, which is no board")
            self.ordered.setdefault(board, self.look[board].state())
        elif cob_id & 0x780 == SDO_REQUEST:
            self._transfer(bus, f"{bus}/{cob_id & 0x7F}", data)

    def _poll(self, board: str, function: int) -> None:
        a, before = self._a, self._polls.get(board)
        require(function == GUARDING and board in self.look, f"a remote frame is sent to {board}")
        if self._runs:
            require(not self._beating(board), f"{board} has heartbeats, and is guarded")
            early = before is not None and a.now - before < self._period / 2 - TICK
            require(not early, f"{board} is polled {a.now - (before or 0):g} s after another poll")
        self._polls[board] = a.now

    def _beating(self, board: str) -> bool:
        look = self.look[board]
        return bool(look.has(0x1016) and look.number(0x1017, 0))

    def _transfer(self, bus: str, board: str, data: bytes) -> None:
        a = self._a
        require(board in self.look and len(data) == 8, f"an SDO request {data.hex()} to {board}")
        index, sub = int.from_bytes(data[1:3], "little"), data[3]
        if data[0] == 0x40:
            self._asked.setdefault(bus, []).append(a.now)
            if index == INPUTS:
                self._input_reads[board] = a.now
            elif index == self._objects.get(board, OUTPUTS):
                self._output_reads[board] = a.now
            return
        if data[0] & 0xE0 != 0x20:
            return
        text = f"{index:04X}h sub {sub} of {board} is written"
        require(not self._runs, f"{text} in mode {a.mode}")
        look = self.look[board]
        if index == self._objects.get(board, OUTPUTS):  # the boot goes on after a stop
            require(a.told in ("starting", "stopped"), f"{text} in mode {a.told}")
        if board in self._kept and look.state() == OPERATIONAL and a.clear:
            require(False, f"{text}, and the board was operational and configured")
        size = 4 - (data[0] >> 2 & 3) if data[0] & 1 else 4
        value = int.from_bytes(data[4 : 4 + size], "little")
        if a.clear and index not in (self._objects.get(board, OUTPUTS), 0x6206):
            require(look.number(index, sub) != value, f"{text} with {value:X}h, which it has")

    def switched(self) -> None:
        """An output has switched: reads and their rate are counted anew."""
        self._asked.clear()
        self._window = self._a.now

    def tick(self) -> None:
        """Finds missing heartbeats, polls and reads."""
        a, now = self._a, self._a.now
        if not a.clear:
            self._began = self._window = now
            self._asked.clear()
            return
        for bus in self._rates:
            gap = now - max(self._beats.get(bus, self._began), self._began)
            require(gap <= self._period + LATE, f"{bus}: no heartbeat of the executor for {gap:g} s")
        if not self._runs:
            self._window = now
            self._asked.clear()
            return
        since = max(a.ready_at, a.clear_since)
        for board in self.look:
            if not self._beating(board):
                gap = now - max(self._polls.get(board, since), since)
                require(gap <= self._period + LATE, f"{board} is not polled for {gap:g} s")
        for board in self._inputs:
            gap = now - max(self._input_reads.get(board, since), since)
            longest = self.period_of(board) + 0.5
            require(gap <= longest, f"the inputs of {board} are not read for {gap:g} s")
        self._judge_read_back(since)
        self._judge_rate()

    def _judge_read_back(self, since: float) -> None:
        """Requires that a board is read back after the last switch, if no other switch follows."""
        a, ground = self._a, self._a.ground
        for k, board in enumerate(a.arm.board_of):
            if board in self._unverified:
                continue
            at = ground.switched_at[k]
            if at > since and a.now > at + READ_BACK:
                read = self._output_reads.get(board, 0.0) > at
                require(read, f"the outputs of {board} are not read for {a.now - at:g} s after a switch")

    def _judge_rate(self) -> None:
        """Requires that the reads leave the bus to others."""
        a, seconds = self._a, self._a.now - self._window
        if seconds < 1.0:
            return
        for bus, times in self._asked.items():
            here = [name for name in self.look if name.startswith(f"{bus}/")]
            pace = max(PACE, 2 * FRAME_BITS / (SHARE * self._rates[bus]))
            inputs = sum(len(self._inputs.get(b, ())) * (seconds / self.period_of(b) + 2) for b in here)
            reads = 2.0 * seconds / pace + 2 * inputs + PULSE_READS * len(here)
            require(len(times) <= reads, f"{bus}: {len(times)} SDO requests in {seconds:.2f} s, {reads:.0f} at most")
        if seconds > 2.0:
            self._window = a.now
            self._asked.clear()
