"""The master's heartbeat, the polls of node guarding, and the clock of timeouts, which stops while the loop stalls."""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence

from hyperbit.drivers.canopen.boards.board import Board
from hyperbit.drivers.canopen.faults import ArmFault
from hyperbit.drivers.canopen.wire import cia301
from hyperbit.drivers.canopen.wire.cia301 import Frame, State
from hyperbit.drivers.canopen.wire.link import Link, Outgoing
from hyperbit.drivers.canopen.wiring import MASTER, Timing, next_due

_LATEST = 0.04  # [s] by which a tick may be late
_PERIOD = 0.01  # [s] between two ticks, unless another one is told
_PHASES = 10  # groups of boards with node guarding, polled at different ticks
BEAT = cia301.heartbeat(MASTER, State.OPERATIONAL)


class Heartbeat:
    """Sends the master's heartbeat, polls guarded boards, and detects pauses of both. `clock` is real time [s]."""

    def __init__(self, links: Collection[Link], boards: Sequence[Board], timing: Timing) -> None:
        self._links, self._boards = links, boards
        self._period, self._timeout = timing.heartbeat, timing.heartbeat_timeout
        self._polls: dict[int, tuple[float, Outgoing]] = {}  # of boards with node guarding, by index: time and frame
        self._last: float | None = None  # time of the last `tick`; None also after a reported pause
        self._sent: dict[str, float] = {}  # time of the last heartbeat on each bus
        self._before: dict[str, float] = {}  # time of the heartbeat before that
        self._due: dict[str, float] = {}  # time of the next heartbeat

    def tick(self, clock: float, now: float) -> None:
        """Sends the heartbeats and polls due at `clock`; `now` stands still while the loop stalls."""
        self._last = clock
        for link in self._links:
            sent, at = self._sent.get(link.name, -math.inf), self._due.get(link.name, -math.inf)
            due = clock >= at - 1e-6
            if link.usable and (due or link.failing or link.misses_echo(now, BEAT)):  # shows whether others were sent
                link.send_frame(BEAT, now)
                self._before[link.name], self._sent[link.name] = sent, clock
                if due:
                    self._due[link.name] = next_due(at, self._period, clock)
        for board in self._boards:
            at, last = self._polls.get(board.index, (-math.inf, None))
            if not board.guarded or not board.link.usable or clock < at + self._period - 1e-6:
                continue
            if last is None:
                at = clock - self._period * (board.index % _PHASES) / _PHASES
            elif last.sent or last.cancelled:
                at = max(at + self._period, clock - self._period / 2)
            else:
                continue
            outgoing = Outgoing(Frame(cia301.REMOTE | cia301.HEARTBEAT + board.layout.node))
            self._polls[board.index] = at, outgoing
            board.link.queue(outgoing, now, urgent=True)

    def next_due(self) -> float:
        """Returns the time of the next heartbeat or poll [s]."""
        polled = (at + self._period for at, _ in self._polls.values())
        return min((*self._due.values(), *polled), default=math.inf)

    def answered(self, board: Board, now: float) -> None:
        """Records a frame that shows that a guarded board got its poll, also if the echo of the poll was lost."""
        if (poll := self._polls.get(board.index)) is not None:
            board.link.answered(poll[1], now)

    def send_failed(self, bus: str, frame: Frame) -> None:
        """Records that a frame could not be sent; the next tick repeats a heartbeat."""
        if frame == BEAT:
            self._sent[bus], self._due[bus] = self._before.get(bus, -math.inf), -math.inf

    def find_pause(self, clock: float) -> ArmFault | None:
        """Returns a fault if boards have lost their master since the last `tick`; each pause once."""
        last = self._last
        if last is None or clock - last < self._timeout - self._period:
            return None
        if not any(link.armed and clock - self._sent.get(link.name, clock) >= self._timeout for link in self._links):
            return None
        self._last = None
        what = "the boards lost their master and did what on_loss says"
        return ArmFault("halted", "executor", f"the executor was halted for {clock - last:.2f} s: {what}")


class LoopClock:
    """Time for timeouts. Between two ticks it advances by at most 40 ms more than their period.

    Frames that arrive during a stall of the loop are read only after it, so a stall alone must end no timeout.
    """

    def __init__(self) -> None:
        self.now = 0.0  # at the last tick [s]
        self.period = _PERIOD  # until the next tick [s]
        self.stalled = False  # the last tick was so late that time stood still
        self._ticked: float | None = None  # real time of the last tick [s]

    def at(self, clock: float) -> float:
        passed = 0.0 if self._ticked is None else clock - self._ticked
        return self.now + min(max(passed, 0.0), self.period + _LATEST)

    def tick(self, clock: float) -> float:
        self.stalled = self._ticked is not None and clock - self._ticked > self.period + _LATEST
        self.now, self._ticked = self.at(clock), clock
        return self.now
