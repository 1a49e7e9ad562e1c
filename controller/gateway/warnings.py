"""The planner's own warnings: the system's clock, the Zenoh network, the ledger. None of them stops the arm."""

import logging
import time
from collections.abc import Callable

from controller.journal import fields_of_fault
from controller.program import Fault

log = logging.getLogger(__name__)

STEP = 0.5  # [s]; a greater jump of the clock was set, not slewed
REMEMBERED = 10.0  # [s] for which a warning stays after its cause


class Warnings:
    """Detects the causes of warnings. Belongs to one thread.

    Args:
        reachable: returns whether the session is connected to an endpoint of its configuration.
        others: returns the active warnings of other parts, such as the ledger.
        wall: the system's clock, UNIX seconds.
        clock: a clock that is never set [s].
    """

    def __init__(
        self,
        reachable: Callable[[], bool] = lambda: True,
        others: Callable[[], tuple[Fault, ...]] = tuple,
        wall: Callable[[], float] = time.time,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._reachable, self._others, self._wall, self._clock = reachable, others, wall, clock
        self._offset = wall() - clock()
        self._set = self._lost = ""  # sentences on the clock and on the network
        self._set_until = self._lost_until = self._lost_at = 0.0
        self._logged: set[tuple[str, str]] = set()

    def active(self) -> tuple[Fault, ...]:
        """Returns the active warnings; logs each when it begins."""
        now = self._clock()
        own = (*self._clock_set(now), *self._network_lost(now))
        for fault in own:
            if (fault.code, fault.source) not in self._logged:
                fields = fields_of_fault(fault.code, fault.source)
                log.warning("%s: %s", fault.code, fault.message, extra={"journal": fields})
        self._logged = {(fault.code, fault.source) for fault in own}
        return own + self._others()

    def _clock_set(self, now: float) -> tuple[Fault, ...]:
        offset = self._wall() - now
        if abs(by := offset - self._offset) > STEP:
            self._set = f"the system's clock was set by {by:+.1f} s: stamps follow it, motions do not"
            self._set_until = now + REMEMBERED
            self._logged.discard(("clock-set", "system"))  # each setting is logged
        self._offset = offset
        return (Fault("clock-set", "system", self._set),) if now < self._set_until else ()

    def _network_lost(self, now: float) -> tuple[Fault, ...]:
        if not self._reachable():
            if now >= self._lost_until:
                self._lost_at = now
            self._lost_until = now + REMEMBERED
            self._lost = (
                f"no peer was connected over Zenoh for {now - self._lost_at:.1f} s: the arm continued by itself"
            )
        return (Fault("network-lost", "zenoh", self._lost),) if now < self._lost_until else ()
