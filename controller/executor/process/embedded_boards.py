"""Simulated boards in the executor's process. Imported with `--simulate` only; no method blocks."""

import math
import os
import select
import stat
import sys
from collections import deque
from collections.abc import Mapping, Sequence
from pathlib import Path

from hyperbit.controller.armfile.strict import InputFaults
from hyperbit.controller.executor.arm.arm import ExecutedArm, read_arm
from hyperbit.controller.program import FaultVerb, PlayableFaults
from hyperbit.drivers.canopen.wire.cia301 import Frame
from hyperbit.drivers.canopen.wire.events import BusChanged, Event, FrameEchoed, FrameReceived
from hyperbit.drivers.canopen.wiring import Timing, Wiring
from hyperbit.drivers.simulation.buses import SimulatedBuses, board_names
from hyperbit.drivers.simulation.fault_commands import VERBS, play
from hyperbit.drivers.simulation.variants import Variant, choose

INPUT = 0  # file descriptor of the standard input
LONGEST_LINE = 1_000  # bytes of a line of the standard input; the beginning of a longer one is lost
MOST_STEPS = 500  # of the boards in one poll; a socket buffers a limited number of frames, too


def simulated_boards(arm: ExecutedArm, board: Sequence[str], wired: Path | None = None) -> "EmbeddedBoards":
    """Returns the simulated boards of an arm, with variants as in `choose`.

    Args:
        arm: as its file says.
        board: variants, as in `choose`.
        wired: file that says how boards and actuators are wired in truth; None: as the arm's own file.

    Raises:
        InputFaults: a name is unknown, or the other file has other actuators.
    """
    true = arm if wired is None else read_arm(wired)
    if wired is not None and true.actuators != arm.actuators:
        raise InputFaults(wired, [f"other actuators than those of {arm.name}: only the wiring may differ"])
    try:
        variants = choose(board, board_names(true.wiring))
    except ValueError as error:
        raise InputFaults(Path("--board"), [str(error)]) from None
    return EmbeddedBoards(true.wiring, true.timing, variants)


class EmbeddedBoards:
    """Simulated boards in place of `CanBuses`, with faults from lines on the standard input.

    The boards live in real time, as real boards do. While this process stands still, their heartbeats continue, and
    they lose their master after its heartbeat timeout. The next poll returns their frames, each with the time of its
    cause.
    """

    def __init__(self, wiring: Wiring, timing: Timing, variants: Mapping[str, Variant] | None = None) -> None:
        self._events: deque[Event] = deque(BusChanged(bus.name, "active", "", None) for bus in wiring.buses)
        self._boards = SimulatedBuses(
            wiring,
            timing,
            lambda bus, frame: self._events.append(FrameReceived(bus, frame, self._at)),
            variants,
            lambda bus, state: self._events.append(BusChanged(bus, state, "", None)),
        )
        self._reads_lines, self._rest = readable(), b""  # of faults, from the standard input
        self._at = -math.inf  # time of the boards [s]

    def simulation(self) -> PlayableFaults:
        verbs = tuple(FaultVerb(verb, *described) for verb, described in VERBS.items())
        return PlayableFaults(
            verbs, tuple(self._boards.names), tuple(self._boards.buses), tuple(self._boards.interlocks)
        )

    def play_fault(self, text: str) -> str:
        return play(self._boards, text)

    def filenos(self) -> list[int]:
        return [INPUT] if self._reads_lines else []

    def wait(self, now: float) -> float:
        return 0.0 if self._events else max(self._boards.next_due() - now, 0.0)

    def poll(self, now: float) -> Sequence[Event]:
        self._read_lines()
        self._advance(now)
        events = list(self._events)
        self._events.clear()
        return events

    def send_frame(self, bus: str, frame: Frame, now: float) -> None:
        self._advance(now)  # actions of the boards before this frame
        if self._boards.passes(bus):
            self._events.append(FrameEchoed(bus, frame, now))
        self._boards.receive(bus, frame, now)

    def close(self) -> None:
        pass

    def _read_lines(self) -> None:
        if not self._reads_lines or not select.select([INPUT], [], [], 0)[0]:
            return
        data = os.read(INPUT, 4096)
        self._reads_lines = bool(data)
        *lines, rest = (self._rest + data).split(b"\n")
        self._rest = rest[-LONGEST_LINE:]
        for text in filter(None, (line.decode(errors="replace").strip() for line in lines)):
            try:
                print(self.play_fault(text), flush=True)
            except ValueError as error:
                print(f"not done: {error}", file=sys.stderr, flush=True)

    def _advance(self, now: float) -> None:
        """Advances the boards to `now` [s], from one of their times to the next; the first call switches them on."""
        for _ in range(MOST_STEPS if self._at > -math.inf else 0):
            if (due := self._boards.next_due()) >= now:
                break
            self._at = max(due, self._at)
            self._boards.step(self._at)
        self._at = max(now, self._at)
        self._boards.step(self._at)


def readable() -> bool:
    """Returns whether the standard input is a pipe, or a terminal that this process may read."""
    try:
        if os.isatty(INPUT):
            return os.tcgetpgrp(INPUT) == os.getpgrp()
        return stat.S_ISFIFO(os.fstat(INPUT).st_mode)
    except OSError:
        return False
