"""Bringing the boards up beside the control loop, which must go on with their heartbeats meanwhile."""

import logging
import threading
from collections.abc import Callable

from controller.daemon.events import Started
from drivers.boards import Boards
from drivers.faults import Fault

log = logging.getLogger(__name__)


class BringUp:
    """One start-up of the boards at a time: two at once would disturb each other. The control loop's.

    Attributes:
        running: whether one is under way.

    Args:
        boards: to bring up.
        ended: takes the end of each, from a thread of its own.
    """

    def __init__(self, boards: Boards, ended: Callable[[Started], None]) -> None:
        self.running = False
        self._boards, self._ended = boards, ended
        self._again = False

    def begin(self) -> None:
        """Begins one, or has another follow the one under way."""
        if self.running:
            self._again = True
            return
        threading.Thread(target=self._work, name="start-up", daemon=True).start()
        self.running, self._again = True, False

    def end(self) -> bool:
        """Notes the end of one; returns whether its outcome counts, which it does not if another follows."""
        self.running = False
        if self._again:
            self.begin()
        return not self.running

    def _work(self) -> None:
        try:
            faults = self._boards.start()
        except Exception as error:
            log.exception("start-up failed")
            faults = [Fault("internal-error", "daemon", f"start-up failed: {error!r}")]
        self._ended(Started(tuple(faults)))
