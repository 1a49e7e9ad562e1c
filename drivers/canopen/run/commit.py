"""The commit of outputs: sends all changed RPDOs; when all of them were sent, one SYNC on each bus.

In a commit that only switches lines off, each bus gets its SYNC as soon as its own RPDOs were sent.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

from drivers.canopen.pdo import union
from drivers.canopen.run.outputs import Key, OutputLines
from drivers.canopen.wire import cia301
from drivers.canopen.wire.cia301 import Frame
from drivers.canopen.wire.link import Link

_SYNC = Frame(cia301.SYNC)


class Commit:
    """Switches all boards of a bus at the same instant.

    SYNC is sent only after all RPDOs of all buses were sent, or of its own bus if lines only go off. So no SYNC waits
    in a queue when a bus fails, and the frames that the kernel still holds switch nothing when the bus comes back.

    A commit can be given up until its SYNC is handed out. Boards that wait for SYNC then keep their outputs. A board
    without SYNC switches when its RPDO is sent, and a frame that was handed out cannot be called back. So the commit
    waits for these frames, as it waits for a SYNC.

    Attributes:
        failed: reason of the last failure, as a sentence; None after a success.
        switched: masks of switched lines, each with the real time of its SYNC [s].

    Args:
        links: the buses by name.
        outputs: output lines of all boards; they change when the SYNC was sent.
        note: takes each mask of switched lines.
        longest: a commit that takes longer is cancelled, since its SYNC would be too late [s, real time].
    """

    def __init__(
        self, links: Mapping[str, Link], outputs: OutputLines, note: Callable[[int], None], longest: float
    ) -> None:
        self.failed: str | None = None
        self.switched: list[tuple[int, float]] = []
        self._links, self._outputs, self._longest = links, outputs, longest
        self._note = note
        self._refusal: Callable[[], str | None] | None = None
        self._together = True
        self._states = 0
        self._began = 0.0
        self._waiting: dict[str, dict[Frame, Key | None]] = {}  # of each bus, frames that were not sent yet
        self._syncs: set[str] = set()  # buses whose SYNC was handed out and not sent yet
        self._leaving: dict[str, dict[Frame, Key]] = {}  # of a commit given up: frames that switch without SYNC

    @property
    def under_way(self) -> bool:
        """Whether a commit is under way."""
        return bool(self._waiting or self._syncs or self._leaving)

    @property
    def collecting(self) -> bool:
        """Whether the commit still waits for RPDOs, so that it has switched nothing."""
        return bool(self._waiting) and not self._syncs

    @property
    def unknown(self) -> bool:
        """Whether a frame that switches was handed out, and may or may not be sent."""
        return bool(self._syncs or self._leaving)

    @property
    def leaving(self) -> int:
        """Mask of the lines that frames already handed out will switch, whatever is commanded now."""
        keys = [key for frames in self._leaving.values() for key in frames.values()]
        lines = union(self._outputs.lines(key) for key in keys) | union(self._outputs.lines_of(b) for b in self._syncs)
        return lines & (self._states ^ self._outputs.states)

    def forget(self) -> None:
        """Cancels the commit; the caller reads the outputs back."""
        for bus in self._syncs:
            self._outputs.bus_lost(bus, self._states)
        self._waiting, self._syncs, self._leaving, self.failed = {}, set(), {}, None

    def begin(
        self,
        states: int,
        due: Mapping[str, Sequence[Key | Frame]],
        refusal: Callable[[], str | None],
        clock: float,
        now: float,
        together: bool = True,
    ) -> None:
        """Starts the switch to the states.

        Args:
            states: levels of all output lines.
            due: RPDOs and NMT commands to send on each bus that needs a SYNC, in order; not empty.
            refusal: returns why nothing may be switched now, or None.
            clock: real time [s].
            now: time that stands still while the loop stalls [s].
            together: whether no bus gets its SYNC before the RPDOs of all buses were sent.
        """
        self.failed, self._together = None, together
        self._states, self._began, self._refusal = states, clock, refusal
        self._waiting = {bus: dict(self._frame(key) for key in keys) for bus, keys in due.items()}
        for bus, frames in list(self._waiting.items()):
            for frame, key in list(frames.items()):
                if key is not None:
                    self._outputs.sending(key)
                self._links[bus].send_frame(frame, now)
        self._sync_when_sent(clock, now)

    def give_up(self, why: str) -> None:
        """Cancels a commit whose SYNC was not handed out: no SYNC is sent for it. Does nothing after that.

        The boards may have latched its RPDOs. `OutputLines.due` sends these frames anew before the next SYNC.
        """
        if self._waiting:
            for bus, frames in self._waiting.items():
                at_once = {f: key for f, key in frames.items() if key is not None and not self._outputs.on_sync(key)}
                if at_once:
                    self._leaving[bus] = at_once
            self._waiting = {}
            self.failed = why

    def sent(self, bus: str, frame: Frame, clock: float, now: float) -> None:
        """Records that a frame of the master was sent."""
        if frame.id == cia301.SYNC:
            self._sync_sent(bus, clock)
        elif frame in (frames := self._waiting.get(bus, {})):
            self._frame_sent(frames.pop(frame), frame, clock)
            self._sync_when_sent(clock, now)
        elif (key := self._left(bus, frame)) is not None:
            self._frame_sent(key, frame, clock)

    def send_failed(self, bus: str, frame: Frame, why: str) -> None:
        """Records that a frame of the master could not be sent."""
        if frame.id == cia301.SYNC and bus in self._syncs:
            self._syncs.remove(bus)
            self.failed = f"{bus}: the SYNC was not sent: {why}"
        elif frame in (frames := self._waiting.get(bus, {})):
            del frames[frame]
            self.give_up(f"{bus}: frame {frame.id:03X}h was not sent: {why}")
        else:
            self._left(bus, frame)

    def bus_lost(self, bus: str) -> None:
        """Records the loss of a bus. Its outputs stay unknown until the boot if its SYNC was handed out."""
        self._outputs.bus_lost(bus, self._states if bus in self._syncs else None)
        if bus in self._syncs:
            self._syncs.remove(bus)
            self.failed = f"{bus} was lost while its SYNC was being sent"
        elif bus in self._waiting:
            del self._waiting[bus]
            self.failed = f"{bus} was lost"
            self.give_up(self.failed)
        self._leaving.pop(bus, None)

    def tick(self, clock: float, now: float) -> None:
        """Call every period. On a bus without echoes, frames that did not fail count as sent."""
        if not self.under_way:
            return
        for bus in [bus for bus in sorted(self._syncs) if not self._links[bus].echoes]:
            self._sync_sent(bus, clock)
        for bus, frames in self._waiting.items():
            if not self._links[bus].echoes:
                for frame, key in frames.items():
                    self._frame_sent(key, frame, clock)
                frames.clear()
        for bus in [bus for bus in self._leaving if not self._links[bus].echoes]:
            for frame, key in self._leaving.pop(bus).items():
                self._frame_sent(key, frame, clock)
        self._sync_when_sent(clock, now)

    def _frame(self, key: Key | Frame) -> tuple[Frame, Key | None]:
        return (key, None) if isinstance(key, Frame) else (self._outputs.frame(key, self._states), key)

    def _left(self, bus: str, frame: Frame) -> Key | None:
        """Removes a frame of the commit given up; returns its key if it was one."""
        key = self._leaving.get(bus, {}).pop(frame, None)
        if not self._leaving.get(bus, True):
            del self._leaving[bus]
        return key

    def _frame_sent(self, key: Key | None, frame: Frame, clock: float) -> None:
        if key is not None and (mask := self._outputs.sent(key, frame, self._states)):
            self._switched(mask, clock)

    def _sync_when_sent(self, clock: float, now: float) -> None:
        if not self._waiting:
            return
        waiting = [bus for bus, frames in self._waiting.items() if frames]
        if clock - self._began > self._longest:
            late = f"frames on {', '.join(waiting)} were not sent" if waiting else "the executor was halted"
            self.give_up(f"{late} for {self._longest:g} s")
        elif ready := [bus for bus in self._waiting if bus not in waiting and not (waiting and self._together)]:
            if self._refusal is not None and (refusal := self._refusal()) is not None:
                self.give_up(refusal)
                return
            for bus in ready:
                del self._waiting[bus]
            self._syncs.update(ready)
            for bus in ready:
                self._links[bus].send_frame(_SYNC, now)

    def _sync_sent(self, bus: str, clock: float) -> None:
        if bus in self._syncs:
            self._syncs.remove(bus)
            if mask := self._outputs.switched(bus, self._states):
                self._switched(mask, clock)

    def _switched(self, mask: int, clock: float) -> None:
        self.switched.append((mask, clock))
        self._note(mask)
