"""Commit: all RPDOs of a change, and when all have left, one SYNC a bus."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from drivers.canopen import cia301
from drivers.canopen.cia301 import Frame
from drivers.canopen.link import Link
from drivers.canopen.outputs import Outputs

_SYNC = Frame(cia301.SYNC)


class Commit:
    """Switches all boards of a bus at one instant.

    A SYNC is handed out only when all RPDOs of all buses have left. So no SYNC waits behind a failure: what the kernel
    still holds when a bus fails switches nothing when the bus comes back.

    Attributes:
        failed: why the last commit failed; None if it did not.
        switched: masks of actuators, with the real time when their SYNC was known to have left [s].

    Args:
        links: by name of the bus.
        outputs: of all boards; they change when a SYNC has left.
        refusal: returns why nothing may be switched, or None.
        longest: a commit that takes longer is given up [s, real time]: its SYNC would come too late.
    """

    def __init__(
        self,
        links: Mapping[str, Link],
        outputs: Outputs,
        refusal: Callable[[], str | None],
        longest: float,
    ) -> None:
        self.failed: str | None = None
        self.switched: list[tuple[int, float]] = []
        self._links, self._outputs, self._longest = links, outputs, longest
        self._refusal = refusal
        self._states = 0
        self._began = 0.0
        self._rpdos: dict[str, dict[Frame, int]] = {}  # of each bus, frames that have not left, with their index
        self._syncs: set[str] = set()  # buses whose SYNC is on its way

    @property
    def under_way(self) -> bool:
        """Whether a commit is under way."""
        return bool(self._rpdos or self._syncs)

    @property
    def unknown(self) -> bool:
        """Whether a SYNC is on its way."""
        return bool(self._syncs)

    def forget(self) -> None:
        """Gives everything up: the boards' outputs are read back."""
        self._rpdos, self._syncs, self.failed = {}, set(), None

    def begin(self, states: int, due: Mapping[str, list[int]], clock: float, now: float) -> None:
        """Begins to switch to the states.

        Args:
            states: of all actuators.
            due: indices of the frames to send on each bus that needs a SYNC; not empty.
            clock: real time [s].
            now: time that stands still while the loop stalls [s].
        """
        self.failed = None
        self._states, self._began = states, clock
        self._rpdos = {bus: {self._outputs.frame(i, states): i for i in frames} for bus, frames in due.items()}
        for bus, frames in list(self._rpdos.items()):
            for frame, i in list(frames.items()):
                self._outputs.sending(i)
                self._links[bus].send(frame, now)
        self._sync_if_left(clock, now)

    def left(self, bus: str, frame: Frame, clock: float, now: float) -> None:
        """Notes that a frame of ours has left."""
        if frame.id == cia301.SYNC:
            self._sync_left(bus, clock)
        elif (i := self._rpdos.get(bus, {}).pop(frame, None)) is not None:
            self._outputs.sent(i, frame)
            self._sync_if_left(clock, now)

    def send_failed(self, bus: str, frame: Frame, why: str) -> None:
        """Notes that a frame of ours was not sent."""
        if frame.id == cia301.SYNC and bus in self._syncs:
            self._syncs.remove(bus)
            self.failed = f"{bus}: the SYNC was not sent: {why}"
        elif frame in self._rpdos.get(bus, {}):
            self._give_up(f"{bus}: frame {frame.id:03X}h was not sent: {why}")

    def bus_lost(self, bus: str) -> None:
        """Notes that a bus is lost. Whether its SYNC has left is unknown until its boards are booted."""
        if bus in self._syncs:
            self._syncs.remove(bus)
            self.failed = f"{bus} was lost while its SYNC was on its way"
        elif bus in self._rpdos:
            self._give_up(f"{bus} was lost")

    def tick(self, clock: float, now: float) -> None:
        """Does what time brings; on a bus that gives no frames back, those that did not fail have left."""
        if not self.under_way:
            return
        for bus in [bus for bus in self._syncs if not self._links[bus].echoes]:
            self._sync_left(bus, clock)
        for bus, frames in self._rpdos.items():
            if not self._links[bus].echoes:
                for frame, i in frames.items():
                    self._outputs.sent(i, frame)
                frames.clear()
        self._sync_if_left(clock, now)

    def _sync_if_left(self, clock: float, now: float) -> None:
        if not self._rpdos:
            return
        waiting = [bus for bus, frames in self._rpdos.items() if frames]
        if clock - self._began > self._longest:
            late = f"frames on {', '.join(waiting)} have not left" if waiting else "the executor was halted"
            self._give_up(f"{late} for {self._longest:g} s")
        elif not waiting:
            if (refusal := self._refusal()) is not None:
                self._give_up(refusal)
                return
            buses, self._rpdos = list(self._rpdos), {}
            self._syncs.update(buses)
            for bus in buses:
                self._links[bus].send(_SYNC, now)

    def _sync_left(self, bus: str, clock: float) -> None:
        if bus in self._syncs:
            self._syncs.remove(bus)
            if mask := self._outputs.switched(bus, self._states):
                self.switched.append((mask, clock))

    def _give_up(self, why: str) -> None:
        self._rpdos = {}
        self.failed = why
