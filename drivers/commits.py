"""RPDOs and SYNCs on their way, so that a SYNC never waits behind a failure."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drivers import cia301
from drivers.bus import CanBus
from drivers.faults import BusBusy, Leaving
from drivers.outputs import Outputs
from drivers.watch import Watch

_LEAVING = 0.005  # [s] for the frames of a commit to leave; else it is gone on with at the next


@dataclass(frozen=True, eq=False)
class _Sync:
    """A SYNC on its way: the image and the (A,) states it brings about, and what was measured before."""

    wanted: NDArray[np.uint8]
    states: NDArray[np.uint8]
    measured: NDArray[np.int8]


class Commits:
    """Switches all boards at one instant a bus: all RPDOs, and when they have left, one SYNC each.

    Args:
        buses: by name.
        outputs: of all boards; they change when a SYNC has left.
        watch: is told which actuators are on their way then.
        news: notified when the last frame of a bus has left.
        longest: a commit that takes longer was halted on its way, and its SYNC would come too late [s].
    """

    def __init__(
        self,
        buses: Mapping[str, CanBus],
        outputs: Outputs,
        watch: Watch,
        news: threading.Condition,
        longest: float,
    ) -> None:
        self._buses, self._outputs, self._watch, self._news = buses, outputs, watch, news
        self._longest = longest
        self._syncs: dict[str, _Sync] = {}

    @property
    def under_way(self) -> bool:
        """Whether a SYNC was sent of which it is not known that it has left."""
        return bool(self._syncs)

    def forget(self) -> None:
        """Waits for no SYNC any more: what became of it is read back from the boards."""
        self._syncs = {}

    def settle(self, now: float) -> None:
        """Takes note of the SYNCs that have left by `now` [s]."""
        for name, sync in list(self._syncs.items()):
            if self._buses[name].armed and self._buses[name].left:
                del self._syncs[name]
                switched = self._outputs.switched(name, sync.wanted)
                self._watch.switched(switched, sync.states, sync.measured, now)

    def send(
        self,
        states: NDArray[np.uint8],
        now: float,
        refuse_unless_up: Callable[[], None],
        measured: Callable[[], NDArray[np.int8]],
    ) -> None:
        """Switches all actuators to their `states`, (A,), at `now` [s].

        Args:
            states: 0 contracted, 1 extended.
            now: [s].
            refuse_unless_up: raises BusBusy when a bus or board is lost.
            measured: returns what the end-stops read.

        Raises:
            BusBusy: a frame could not be queued or has not left yet, or a bus or board is lost.
        """
        self.settle(now)
        if self._syncs:
            raise Leaving(f"a SYNC on {', '.join(self._syncs)} is still on its way")
        wanted, began = self._outputs.wanted(states), time.monotonic()
        due = self._outputs.due(wanted)
        if not due:
            return
        refuse_unless_up()
        for name, frames in due.items():
            for frame in frames:
                self._outputs.latch(self._buses[name], frame, wanted)
        self._await_leaving(due, began)
        refuse_unless_up()
        for name in due:
            sync = _Sync(wanted, states, measured())
            self._buses[name].send(cia301.frame(cia301.SYNC))
            self._syncs[name] = sync
        self._await_leaving(due, began)
        self.settle(now)

    def _await_leaving(self, buses: Iterable[str], began: float) -> None:
        """Waits a little for what was sent to leave.

        Raises:
            Leaving: it did not.
            BusBusy: this process was halted meanwhile.
        """
        waiting = [bus for name in buses if not (bus := self._buses[name]).left]
        with self._news:
            patience = max(began + _LEAVING - time.monotonic(), 0.0)
            left = self._news.wait_for(lambda: all(bus.left for bus in waiting), patience)
        if not left:
            raise Leaving(f"what was sent on {', '.join(bus.name for bus in waiting)} has not left yet")
        if time.monotonic() - began > self._longest:
            raise BusBusy("the daemon was halted on its way to a SYNC")
