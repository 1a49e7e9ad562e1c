"""The buses of the event loop: CAN buses, or simulated boards in this process. No method blocks."""

import logging
import math
import os
import select
import stat
import sys
from collections import deque
from collections.abc import Mapping, Sequence
from typing import Protocol

from drivers.canopen.faults import BusError
from drivers.canopen.wire.bus import CanBus
from drivers.canopen.wire.cia301 import Frame
from drivers.canopen.wire.events import Changed, Echoed, Event, Received, SendFailed
from drivers.canopen.wiring import BusSettings, Timing, Wiring
from drivers.simulation.buses import SimulatedBuses
from drivers.simulation.fault_commands import perform
from drivers.simulation.variants import Variant

log = logging.getLogger(__name__)

OPEN_EVERY = 1.0  # [s] between two attempts to open a bus that does not exist
POLL_EVERY = 0.002  # [s] where a bus has no file descriptor
INPUT = 0  # file descriptor of the standard input
MOST_STEPS = 100  # of the boards in one poll
LONGEST = 0.02  # [s] of simulated time between two calls: a stall of the process stalls the boards as well


class Buses(Protocol):
    """All buses of an arm."""

    def filenos(self) -> list[int]:
        """Returns the file descriptors to wait on."""

    def wait(self, now: float) -> float:
        """Returns the longest time to wait before the next `poll` [s]."""

    def poll(self, now: float) -> Sequence[Event]:
        """Returns the events since the last call."""

    def send(self, bus: str, frame: Frame, now: float) -> None:
        """Sends a frame; an event tells whether it was sent."""

    def close(self) -> None:
        """Closes all buses and sends nothing: the boards lose the master and do what `on_loss` says."""


class CanBuses:
    """CAN buses over python-can. See `Buses`. A missing bus is opened as soon as it exists."""

    def __init__(self, settings: Sequence[BusSettings]) -> None:
        """Takes the settings of each bus."""
        self._buses = {one.name: CanBus(one) for one in settings}
        self._unopened = set(self._buses)
        self._next_try = 0.0
        self._failed: deque[Event] = deque()

    def filenos(self) -> list[int]:
        """See `Buses`."""
        numbers = [bus.fileno() for bus in self._buses.values()]
        return [number for number in numbers if number is not None]

    def wait(self, now: float) -> float:
        """See `Buses`."""
        if self._failed:
            return 0.0
        return math.inf if all(bus.fileno() is not None for bus in self._buses.values()) else POLL_EVERY

    def poll(self, now: float) -> Sequence[Event]:
        """See `Buses`."""
        if self._unopened and now >= self._next_try:
            self._open(now)
        events = list(self._failed)
        self._failed.clear()
        for bus in self._buses.values():
            events += bus.poll()
        return events

    def send(self, bus: str, frame: Frame, now: float) -> None:
        """See `Buses`."""
        why = self._buses[bus].send(frame)
        if why is not None:
            self._failed.append(SendFailed(bus, frame, why))

    def close(self) -> None:
        """See `Buses`."""
        for bus in self._buses.values():
            bus.close()

    def _open(self, now: float) -> None:
        first, self._next_try = self._next_try == 0.0, now + OPEN_EVERY
        for name in sorted(self._unopened):
            try:
                self._buses[name].open()
                self._unopened.discard(name)
            except BusError as error:
                if first:
                    log.error("%s; tried again every %g s", error, OPEN_EVERY)


class EmbeddedBoards:
    """Simulated boards, with faults from lines on the standard input. See `Buses`.

    Frames have the boards' own time, which stands still while the process stalls.
    """

    def __init__(self, wiring: Wiring, timing: Timing, variants: Mapping[str, Variant] | None = None) -> None:
        """Takes wiring and times of the arm, and the variant of each board by the board's name."""
        self._events: deque[Event] = deque(Changed(bus.name, "active", "", None) for bus in wiring.buses)
        self._boards = SimulatedBuses(
            wiring, timing, lambda bus, frame: self._events.append(Received(bus, frame, self._at)), variants
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

    def send(self, bus: str, frame: Frame, now: float) -> None:
        """See `Buses`."""
        self._at = self._time(now)
        self._events.append(Echoed(bus, frame, self._at))
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
