"""The CAN buses of the event loop. No method blocks."""

import logging
import math
import time
from collections import deque
from collections.abc import Sequence

from hyperbit.drivers.canopen.faults import BusError
from hyperbit.drivers.canopen.wire import cia301
from hyperbit.drivers.canopen.wire.bus import CanBus, InterfaceInUse
from hyperbit.drivers.canopen.wire.cia301 import Frame, State
from hyperbit.drivers.canopen.wire.events import Event, FrameEchoed, FrameReceived, SendFailed
from hyperbit.drivers.canopen.wiring import MASTER, BusWiring

log = logging.getLogger(__name__)

OPEN_EVERY = 1.0  # [s] between two attempts to open a bus that does not exist
POLL_EVERY = 0.002  # [s] where a bus has no file descriptor
LISTEN, PERIODS = 0.25, 2.5  # time to listen for another master before the first frame: [s], and in heartbeat periods
APART = 0.01  # [s], least time between two heartbeats of a live master; frames kept by the kernel come at once
MASTER_BEAT = cia301.heartbeat(MASTER, State.OPERATIONAL)


class CanBuses:
    """All buses of an arm, over python-can. A missing bus is opened as soon as it exists."""

    def __init__(self, settings: Sequence[BusWiring]) -> None:
        self._buses = {one.name: CanBus(one) for one in settings}
        self._unopened = set(self._buses)
        self._told: dict[str, str] = {}  # why a bus could not be opened
        self._next_try = 0.0
        self._waiting: deque[Event] = deque()

    def listen(self, heartbeat: float, least: float = LISTEN, apart: float = APART) -> None:
        """Listens for another master; blocks, so call it before the loop. Other frames are dropped.

        Raises BusError if another master sends its heartbeat, or if another process of this computer owns an interface.

        Args:
            heartbeat: the own period [s].
            least: shortest time to listen [s].
            apart: see APART.
        """
        until = time.monotonic() + max(least, PERIODS * heartbeat)
        first: dict[str, float] = {}  # time of the first heartbeat, by bus
        while (now := time.monotonic()) < until:
            for event in self.poll(now):
                if not isinstance(event, FrameEchoed | FrameReceived):
                    self._waiting.append(event)
                elif event.frame == MASTER_BEAT and now - first.setdefault(event.bus, now) > apart:
                    raise BusError(
                        f"{event.bus}: another executor is on this bus (the heartbeat of node {MASTER}): stop it first,"
                        " only one may switch the boards of a bus"
                    )
            time.sleep(POLL_EVERY)

    def filenos(self) -> list[int]:
        numbers = [bus.fileno() for bus in self._buses.values()]
        return [number for number in numbers if number is not None]

    def wait(self, now: float) -> float:
        """Returns the longest time to wait before the next `poll` [s]."""
        if self._waiting:
            return 0.0
        return math.inf if all(bus.fileno() is not None for bus in self._buses.values()) else POLL_EVERY

    def poll(self, now: float) -> Sequence[Event]:
        if self._unopened and now >= self._next_try:
            self._open(now)
        events = list(self._waiting)
        self._waiting.clear()
        for bus in self._buses.values():
            events += bus.poll()
        return events

    def send_frame(self, bus: str, frame: Frame, now: float) -> None:
        why = self._buses[bus].send_frame(frame)
        if why is not None:
            self._waiting.append(SendFailed(bus, frame, why))

    def play_fault(self, text: str) -> str:
        raise ValueError("the boards are real: faults are played in simulated boards only")

    def close(self) -> None:
        """Closes all buses and sends nothing: the boards lose the master and do what `on_loss` says."""
        for bus in self._buses.values():
            bus.close()

    def _open(self, now: float) -> None:
        first, self._next_try = self._next_try == 0.0, now + OPEN_EVERY
        for name in sorted(self._unopened):
            try:
                self._buses[name].open()
                self._unopened.discard(name)
            except BusError as error:
                if first and isinstance(error, InterfaceInUse):  # the loop has not begun
                    raise
                if str(error) != self._told.get(name):
                    self._told[name] = str(error)
                    log.error("%s; tried again every %g s", error, OPEN_EVERY)
