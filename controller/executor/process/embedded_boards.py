"""Simulated boards in the executor's process. Imported with `--simulate` only; no method blocks."""

import math
import os
import select
import stat
import sys
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from controller.armfile.strict import InputFaults
from controller.executor.core.arm import ExecutedArm
from drivers.canopen.wire.cia301 import Frame
from drivers.canopen.wire.events import BusChanged, Event, FrameEchoed, FrameReceived
from drivers.canopen.wiring import Timing, Wiring
from drivers.simulation.buses import SimulatedBuses, board_names
from drivers.simulation.fault_commands import perform
from drivers.simulation.variants import Variant, choose

STALL_ALLOWANCE = 10.0  # [s] added to the heartbeat timeout of simulated boards, which stall with this process
INPUT = 0  # file descriptor of the standard input
MOST_STEPS = 100  # of the boards in one poll
LONGEST = 0.02  # [s] of simulated time between two calls: a stall of the process stalls the boards as well


def simulated(arm: ExecutedArm, board: Sequence[str]) -> tuple[ExecutedArm, "EmbeddedBoards"]:
    """Returns the arm with the times of simulated boards, and its simulated boards.

    Args:
        arm: from its file.
        board: variants of the boards, in the notation of `choose`.

    Raises:
        InputFaults: a board or variant is unknown.
    """
    arm = replace(arm, timing=replace(arm.timing, heartbeat_timeout=arm.timing.heartbeat_timeout + STALL_ALLOWANCE))
    try:
        variants = choose(board, board_names(arm.wiring))
    except ValueError as error:
        raise InputFaults(Path("--board"), [str(error)]) from None
    return arm, EmbeddedBoards(arm.wiring, arm.timing, variants)


class EmbeddedBoards:
    """Simulated boards, with faults from lines on the standard input. See `Buses`.

    Frames have the boards' own time, which stands still while the process stalls.
    """

    def __init__(self, wiring: Wiring, timing: Timing, variants: Mapping[str, Variant] | None = None) -> None:
        """Takes wiring and times of the arm, and the variant of each board by the board's name."""
        self._events: deque[Event] = deque(BusChanged(bus.name, "active", "", None) for bus in wiring.buses)
        self._boards = SimulatedBuses(
            wiring, timing, lambda bus, frame: self._events.append(FrameReceived(bus, frame, self._at)), variants
        )
        self._lines = FaultLines(self._boards)
        self._clock = self._last = self._at = -math.inf

    def filenos(self) -> list[int]:
        """See `Buses`."""
        return [INPUT] if self._lines.open else []

    def wait(self, now: float) -> float:
        """See `Buses`."""
        return 0.0 if self._events else max(self._boards.next_due() - self._clock, 0.0)

    def poll(self, now: float) -> Sequence[Event]:
        """See `Buses`."""
        self._lines.read()
        begun = self._last > -math.inf
        until = self._time(now)
        for _ in range(MOST_STEPS if begun else 0):  # each frame gets the time of its cause
            if (due := self._boards.next_due()) >= until:
                break
            self._at = max(due, self._at)
            self._boards.step(self._at)
        self._at = until
        self._boards.step(until)
        events = list(self._events)
        self._events.clear()
        return events

    def send_frame(self, bus: str, frame: Frame, now: float) -> None:
        """See `Buses`."""
        self._at = self._time(now)
        self._events.append(FrameEchoed(bus, frame, self._at))
        self._boards.receive(bus, frame, self._at)

    def close(self) -> None:
        """See `Buses`."""

    def _time(self, now: float) -> float:
        """Returns the boards' time [s]."""
        self._clock = now if self._last == -math.inf else self._clock + min(max(now - self._last, 0.0), LONGEST)
        self._last = now
        return self._clock


class FaultLines:
    """Reads faults of simulated boards from lines on the standard input.

    Attributes:
        open: whether more lines may come.

    Args:
        boards: simulated.
    """

    def __init__(self, boards: SimulatedBuses) -> None:
        self.open = readable()
        self._boards, self._rest = boards, b""

    def read(self) -> None:
        """Causes the faults of the lines that wait."""
        if not self.open or not select.select([INPUT], [], [], 0)[0]:
            return
        data = os.read(INPUT, 4096)
        self.open = bool(data)
        *lines, self._rest = (self._rest + data).split(b"\n")
        for line in lines:
            text = line.decode(errors="replace").strip()
            if text:
                self._act(text)

    def _act(self, text: str) -> None:
        try:
            perform(self._boards, *text.split())
        except (ValueError, KeyError) as error:
            print(f"not done: {error.args[0]}", file=sys.stderr, flush=True)
        else:
            print(f"done: {text}", flush=True)


def readable() -> bool:
    """Returns whether the standard input is a pipe, or a terminal that this process may read."""
    try:
        if os.isatty(INPUT):
            return os.tcgetpgrp(INPUT) == os.getpgrp()
        return stat.S_ISFIFO(os.fstat(INPUT).st_mode)
    except OSError:
        return False
