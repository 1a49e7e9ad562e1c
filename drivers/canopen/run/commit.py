"""The commit of one bus: hands out RPDOs, then SYNC, and knows what was sent."""

from __future__ import annotations

from collections.abc import Sequence

from hyperbit.drivers.canopen.boards.outputs import Key, OutputLines
from hyperbit.drivers.canopen.pdo import union
from hyperbit.drivers.canopen.wire import cia301
from hyperbit.drivers.canopen.wire.cia301 import Frame
from hyperbit.drivers.canopen.wire.link import Link

_SYNC = Frame(cia301.SYNC)
_LONGEST = 1.0  # [s] from the begin of a commit, until its frames are sent or its bus is lost


class BusCommit:
    """Switches all boards of one bus at one instant.

    A commit can be given up until its SYNC is handed out. Boards that wait for SYNC then keep their outputs. A board
    without SYNC switches when its RPDO is sent, and a frame that was handed out cannot be called back. So the next
    commit of the bus waits for these frames, as it waits for a SYNC. It also waits for every older RPDO with its
    COB-ID.

    `record` takes the masks of switched lines, each with the real time of its SYNC [s].
    """

    def __init__(self, link: Link, outputs: OutputLines, record: list[tuple[int, float]]) -> None:
        self.link, self.bus = link, link.name
        self.states = 0  # levels of all lines after the commit
        self.began = 0.0  # [s, real time]
        self.collecting = False  # no SYNC was handed out: only boards without SYNC have switched
        self.waiting: dict[Frame, Key | None] = {}  # RPDOs and NMT commands that were handed out and not sent yet
        self.failed: str | None = None  # why, as a sentence
        self._outputs, self._record = outputs, record
        self._syncing = False  # SYNC was handed out and not sent yet
        self._leaving: dict[Frame, Key] = {}  # frames of an abandoned commit that switch without SYNC

    @property
    def under_way(self) -> bool:
        """Whether a frame under way may still switch something."""
        return self.collecting or self.unknown

    @property
    def unknown(self) -> bool:
        """Whether a frame that switches was handed out, and its sending is not confirmed."""
        return self._syncing or bool(self._leaving)

    @property
    def leaving(self) -> int:
        """Mask of the lines that frames under way will switch, whatever is commanded now."""
        lines = union(self._outputs.frames[key].lines for key in self._leaving.values())
        if self._syncing:
            lines |= self._outputs.lines_of(self.bus)
        return lines & (self.states ^ self._outputs.commanded)

    def refusal(self, keys: Sequence[Key]) -> str | None:
        if self.under_way:
            return "frames of the previous commit were not sent yet"
        older = [cob_id for _, cob_id in keys if self.link.pending.holds(cob_id)]
        return f"{self.bus}: an older frame {older[0]:03X}h was not sent yet" if older else None

    def begin(self, states: int, orders: Sequence[Frame], keys: Sequence[Key], clock: float, now: float) -> None:
        """Hands out NMT commands, then RPDOs. Call `sync` when none of them waits."""
        self.states, self.collecting, self.failed, self.began = states, True, None, clock
        self.waiting = dict.fromkeys(orders) | {self._outputs.send(key, states): key for key in keys}
        for frame in list(self.waiting):
            self.link.send_frame(frame, now)

    def sync(self, now: float) -> None:
        self.collecting, self._syncing = False, True
        self.link.send_frame(_SYNC, now)

    def give_up(self, why: str) -> None:
        """Cancels the commit unless its SYNC was handed out. No SYNC is then sent for it.

        The boards may have latched its RPDOs. `OutputLines.due` sends these frames anew before the next SYNC.
        """
        if self.collecting:
            frames = self._outputs.frames
            self._leaving |= {f: key for f, key in self.waiting.items() if key and not frames[key].on_sync}
            self.waiting, self.collecting, self.failed = {}, False, why

    def lost(self) -> None:
        """Records the loss of the bus. Outputs that frames under way switch stay unknown until the boot."""
        if self._syncing:
            self.failed = f"{self.bus} was lost while its SYNC was being sent"
        self.give_up(f"{self.bus} was lost")
        self._outputs.bus_lost(self.bus, self.leaving)
        self._syncing, self._leaving = False, {}

    def sent(self, frame: Frame, clock: float) -> None:
        switched = 0
        if frame.id == cia301.SYNC:
            if self._syncing:
                self._syncing = False
                switched = self._outputs.switched(self.bus, self.states)
        elif key := self.waiting.pop(frame, None) or self._leaving.pop(frame, None):
            switched = self._outputs.sent(key, frame, self.states)
        if switched:
            self._record.append((switched, clock))

    def send_failed(self, frame: Frame, why: str) -> None:
        if frame.id == cia301.SYNC and self._syncing:
            self._syncing, self.failed = False, f"{self.bus}: the SYNC was not sent: {why}"
        elif frame in self.waiting:
            del self.waiting[frame]
            self.give_up(f"{self.bus}: frame {frame.id:03X}h was not sent: {why}")
        else:
            self._leaving.pop(frame, None)

    def tick(self, clock: float) -> None:
        if self.unknown and clock - self.began > _LONGEST:  # unknown result: nothing may wait for a frame for ever
            self.lost()
        if not self.link.echoes:  # frames that did not fail count as sent
            for frame in [*self.waiting, *self._leaving, *([_SYNC] if self._syncing else ())]:
                self.sent(frame, clock)
