"""Commit: all RPDOs of a change, and when all have left, one SYNC a bus."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

from drivers.canopen import cia301
from drivers.canopen.cia301 import Frame
from drivers.canopen.link import Link
from drivers.canopen.outputs import Key, Outputs

_SYNC = Frame(cia301.SYNC)


class Commit:
    """Switches all boards of a bus at one instant.

    A SYNC is handed out only when all RPDOs of all buses have left. So no SYNC waits behind a failure: what the kernel
    still holds when a bus fails switches nothing when the bus comes back.

    Attributes:
        failed: why the last commit failed; None if it did not.
        switched: masks of lines, with the real time when their SYNC was known to have left [s].

    Args:
        links: by name of the bus.
        outputs: of all boards; they change when a SYNC has left.
        note: takes each mask of lines that were switched.
        longest: a commit that takes longer is given up [s, real time]: its SYNC would come too late.
    """

    def __init__(
        self, links: Mapping[str, Link], outputs: Outputs, note: Callable[[int], None], longest: float
    ) -> None:
        self.failed: str | None = None
        self.switched: list[tuple[int, float]] = []
        self._links, self._outputs, self._longest = links, outputs, longest
        self._note = note
        self._refusal: Callable[[], str | None] = lambda: None
        self._states = 0
        self._began = 0.0
        self._waiting: dict[str, dict[Frame, Key | None]] = {}  # of each bus, frames that have not left
        self._syncs: set[str] = set()  # buses whose SYNC is on its way

    @property
    def under_way(self) -> bool:
        """Whether a commit is under way."""
        return bool(self._waiting or self._syncs)

    @property
    def collecting(self) -> bool:
        """Whether RPDOs are still on their way on each bus of the commit: nothing has switched by it."""
        return bool(self._waiting) and not self._syncs

    @property
    def unknown(self) -> bool:
        """Whether a SYNC is on its way."""
        return bool(self._syncs)

    def forget(self) -> None:
        """Gives everything up: the boards' outputs are read back."""
        self._waiting, self._syncs, self.failed = {}, set(), None

    def begin(
        self,
        states: int,
        due: Mapping[str, Sequence[Key | Frame]],
        refusal: Callable[[], str | None],
        clock: float,
        now: float,
    ) -> None:
        """Begins to switch to the states.

        Args:
            states: levels of all output lines.
            due: RPDOs, and orders, to send on each bus that needs a SYNC, in order; not empty.
            refusal: returns why nothing may be switched, or None.
            clock: real time [s].
            now: time that stands still while the loop stalls [s].
        """
        self.failed = None
        self._states, self._began, self._refusal = states, clock, refusal
        self._waiting = {bus: dict(self._frame(key) for key in keys) for bus, keys in due.items()}
        for bus, frames in list(self._waiting.items()):
            for frame, key in list(frames.items()):
                if key is not None:
                    self._outputs.sending(key)
                self._links[bus].send(frame, now)
        self._sync_if_left(clock, now)

    def give_up(self, why: str) -> None:
        """Gives up what waits; nothing of it is sent later. A SYNC that is on its way is left alone."""
        if self._waiting:
            self._waiting = {}
            self.failed = why

    def left(self, bus: str, frame: Frame, clock: float, now: float) -> None:
        """Notes that a frame of ours has left."""
        if frame.id == cia301.SYNC:
            self._sync_left(bus, clock)
        elif frame in (frames := self._waiting.get(bus, {})):
            self._frame_left(frames.pop(frame), frame, clock)
            self._sync_if_left(clock, now)

    def send_failed(self, bus: str, frame: Frame, why: str) -> None:
        """Notes that a frame of ours was not sent."""
        if frame.id == cia301.SYNC and bus in self._syncs:
            self._syncs.remove(bus)
            self.failed = f"{bus}: the SYNC was not sent: {why}"
        elif frame in self._waiting.get(bus, {}):
            self.give_up(f"{bus}: frame {frame.id:03X}h was not sent: {why}")

    def bus_lost(self, bus: str) -> None:
        """Notes that a bus is lost. Whether its SYNC has left is unknown until its boards are booted."""
        if bus in self._syncs:
            self._syncs.remove(bus)
            self.failed = f"{bus} was lost while its SYNC was on its way"
        elif bus in self._waiting:
            self.give_up(f"{bus} was lost")

    def tick(self, clock: float, now: float) -> None:
        """Does what time brings; on a bus that gives no frames back, those that did not fail have left."""
        if not self.under_way:
            return
        for bus in [bus for bus in self._syncs if not self._links[bus].echoes]:
            self._sync_left(bus, clock)
        for bus, frames in self._waiting.items():
            if not self._links[bus].echoes:
                for frame, key in frames.items():
                    self._frame_left(key, frame, clock)
                frames.clear()
        self._sync_if_left(clock, now)

    def _frame(self, key: Key | Frame) -> tuple[Frame, Key | None]:
        return (key, None) if isinstance(key, Frame) else (self._outputs.frame(key, self._states), key)

    def _frame_left(self, key: Key | None, frame: Frame, clock: float) -> None:
        if key is not None and (mask := self._outputs.sent(key, frame, self._states)):
            self._switched(mask, clock)

    def _sync_if_left(self, clock: float, now: float) -> None:
        if not self._waiting:
            return
        waiting = [bus for bus, frames in self._waiting.items() if frames]
        if clock - self._began > self._longest:
            late = f"frames on {', '.join(waiting)} have not left" if waiting else "the executor was halted"
            self.give_up(f"{late} for {self._longest:g} s")
        elif not waiting:
            if (refusal := self._refusal()) is not None:
                self.give_up(refusal)
                return
            buses, self._waiting = list(self._waiting), {}
            self._syncs.update(buses)
            for bus in buses:
                self._links[bus].send(_SYNC, now)

    def _sync_left(self, bus: str, clock: float) -> None:
        if bus in self._syncs:
            self._syncs.remove(bus)
            if mask := self._outputs.switched(bus, self._states):
                self._switched(mask, clock)

    def _switched(self, mask: int, clock: float) -> None:
        self.switched.append((mask, clock))
        self._note(mask)
