"""What is wrong and stops no arm: told in the state, and in the journal when it begins."""

import logging
import time
from collections.abc import Callable

from controller.daemon.ledger import Ledger
from drivers.boards import Boards
from drivers.faults import Fault

log = logging.getLogger(__name__)

STEP = 0.5  # [s] by which a clock is set at least, not slewed
REMEMBERED = 10.0  # [s] for which what is over is still told


class Worries:
    """Looks after the buses, the system's clock, the network and the ledger. The control loop's.

    Args:
        boards: connected.
        ledger: of switches and goals.
        reachable: whether anybody is connected of those that the daemon was told to connect to.
        wall: the system's clock, UNIX seconds.
        clock: one that is never set [s].
    """

    def __init__(
        self,
        boards: Boards,
        ledger: Ledger,
        reachable: Callable[[], bool] = lambda: True,
        wall: Callable[[], float] = lambda: time.time(),
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._boards, self._ledger, self._reachable, self._wall, self._clock = boards, ledger, reachable, wall, clock
        self._offset = wall() - clock()
        self._set = self._lost = ""  # what happened to the clock and to the network
        self._set_until = self._lost_until = self._lost_at = 0.0
        self._told: set[tuple[str, str]] = set()

    def look(self) -> tuple[Fault, ...]:
        """Returns what is wrong now, or was a moment ago."""
        now = self._clock()
        own = (*self._boards.passive(), *self._clock_set(now), *self._network_lost(now))
        for fault in own:
            if (fault.code, fault.source) not in self._told:
                log.warning("%s: %s", fault.code, fault.message)
        self._told = {(fault.code, fault.source) for fault in own}
        return own + self._ledger.faults()

    def _clock_set(self, now: float) -> tuple[Fault, ...]:
        offset = self._wall() - now
        if abs(by := offset - self._offset) > STEP:
            self._set = f"the system's clock was set by {by:+.1f} s: stamps go with it, motions do not"
            self._set_until = now + REMEMBERED
            self._told.discard(("clock-set", "system"))  # set once more, it is told once more
        self._offset = offset
        return (Fault("clock-set", "system", self._set),) if now < self._set_until else ()

    def _network_lost(self, now: float) -> tuple[Fault, ...]:
        if not self._reachable():
            if now >= self._lost_until:
                self._lost_at = now
            self._lost_until = now + REMEMBERED
            self._lost = f"nobody was connected over Zenoh for {now - self._lost_at:.1f} s: the arm went on by itself"
        return (Fault("network-lost", "zenoh", self._lost),) if now < self._lost_until else ()
