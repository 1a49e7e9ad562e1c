"""Transmit echo: frames that were handed out and not yet echoed by the interface."""

from __future__ import annotations

import math
from collections import Counter

from hyperbit.drivers.canopen.wire import cia301
from hyperbit.drivers.canopen.wire.cia301 import REMOTE, Frame

HandedOut = tuple[int, float]  # number of a frame that was handed out, and time [s]


class TxPending:
    """The frames that wait for their echo; `last_echo` is the time of the last echo [s].

    SocketCAN echoes each frame when it was sent (receive_own_messages). Frames are matched by identifier and data,
    since controllers with several mailboxes do not keep the order. All controllers send a frame before one that was
    handed out later and has a greater identifier. So the echo of the later frame shows that the echo of the earlier
    one was lost. Some interfaces never echo frames: no frame counts as pending until the first echo.
    """

    def __init__(self) -> None:
        self.last_echo: float | None = None
        self._number = 0
        self._pending: dict[Frame, list[HandedOut]] = {}
        self._given_up: Counter[Frame] = Counter()

    @property
    def count(self) -> int:
        return 0 if self.last_echo is None else sum(map(len, self._pending.values()))

    @property
    def oldest(self) -> float | None:
        """Time when the oldest pending frame was handed out [s]; None if no frame is pending."""
        if self.last_echo is None:
            return None
        return min((outs[0][1] for outs in self._pending.values()), default=None)

    def holds(self, cob_id: int) -> bool:
        """Returns whether a frame with an identifier is pending."""
        return self.last_echo is not None and any(frame.id == cob_id for frame in self._pending)

    def commanded(self, before: float) -> bool:
        """Returns whether an NMT command, SYNC or RPDO is pending that was handed out before a time [s]."""
        outs = (outs[0][1] for frame, outs in self._pending.items() if frame.id < cia301.SDO_ANSWER)
        return self.last_echo is not None and min(outs, default=before) < before

    def sent(self, frame: Frame, now: float) -> None:
        """Records a frame that is handed out."""
        self._number += 1
        self._pending.setdefault(frame, []).append((self._number, now))

    def failed(self, frame: Frame) -> bool:
        """Removes a frame that could not be sent; returns whether it was pending."""
        return self._remove(frame) is not None

    def came_back(self, frame: Frame, now: float) -> list[Frame]:
        """Takes an echo; returns the frames that were sent, whose echoes were lost but for the last; none: not ours."""
        if (out := self._remove(frame)) is None:
            if frame not in self._given_up:
                return []
            self._given_up[frame] -= 1
            self._given_up = +self._given_up  # without zeros
            self.last_echo = now
            return [frame]
        self.last_echo = now
        lost = [f for f, outs in self._pending.items() for o in outs if f.id & ~REMOTE < frame.id & ~REMOTE and o < out]
        for each in lost:
            self._remove(each)
        self._given_up.update(lost)
        return [*lost, frame]

    def give_up(self, before: float = math.inf) -> None:
        """Stops to wait for frames that were handed out before a time [s]; their echoes are still recognized."""
        for frame in [frame for frame, outs in self._pending.items() if outs[0][1] < before]:
            self._given_up[frame] += len(self._pending.pop(frame))

    def forget(self) -> None:
        """Forgets all frames: a bus that was opened again cannot echo them."""
        self._pending.clear()
        self._given_up.clear()

    def _remove(self, frame: Frame) -> HandedOut | None:
        if (outs := self._pending.get(frame)) is None:
            return None
        out = outs.pop(0)
        if not outs:
            del self._pending[frame]
        return out
