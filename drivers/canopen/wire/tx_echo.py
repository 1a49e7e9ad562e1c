"""Transmit echo: frames that were handed out and not yet echoed by the interface."""

from __future__ import annotations

from collections import Counter

from drivers.canopen.wire.cia301 import Frame


class TxPending:
    """The frames that wait for their echo.

    SocketCAN echoes each frame when it was sent (receive_own_messages). Frames are matched by identifier and data,
    since controllers with several mailboxes do not keep the order. Some interfaces never echo frames: no frame counts
    as pending until the first echo.

    Attributes:
        last_echo: time of the last echo [s]; None before the first.

    Args:
        longest: a frame is not waited for any longer [s]: its echo may have been lost.
    """

    def __init__(self, longest: float) -> None:
        self.last_echo: float | None = None
        self._longest = longest
        self._pending: dict[Frame, list[float]] = {}
        self._given_up: Counter[Frame] = Counter()
        self._count = 0

    @property
    def waiting(self) -> bool:
        """Whether a frame is pending."""
        return self._count > 0 and self.last_echo is not None

    @property
    def count(self) -> int:
        """Number of pending frames."""
        return 0 if self.last_echo is None else self._count

    @property
    def oldest(self) -> float | None:
        """Time when the oldest pending frame was handed out [s]; None if no frame is pending."""
        if not self._count or self.last_echo is None:
            return None
        return min(times[0] for times in self._pending.values())

    def sent(self, frame: Frame, now: float) -> None:
        """Records a frame that is handed out."""
        self._pending.setdefault(frame, []).append(now)
        self._count += 1

    def failed(self, frame: Frame) -> bool:
        """Removes a frame that could not be sent; returns whether it was pending."""
        return self._remove(frame)

    def came_back(self, frame: Frame, now: float) -> bool:
        """Takes an echo; returns whether the master had sent the frame."""
        ours = self._remove(frame)
        if not ours and frame in self._given_up:
            self._given_up[frame] -= 1
            self._given_up = +self._given_up  # without zeros
            ours = True
        if ours:
            self.last_echo = now
        return ours

    def tick(self, now: float) -> None:
        """Stops to wait for frames that are pending for longer than `longest`."""
        for old in [frame for frame, times in self._pending.items() if now - times[0] > self._longest]:
            self._give_up(old)

    def give_up(self) -> None:
        """Stops to wait for all pending frames; their echoes are still recognized."""
        for frame in list(self._pending):
            self._give_up(frame)

    def forget(self) -> None:
        """Forgets all frames: a bus that was opened again cannot echo them."""
        self._pending.clear()
        self._given_up.clear()
        self._count = 0

    def _give_up(self, frame: Frame) -> None:
        times = self._pending.pop(frame)
        self._count -= len(times)
        self._given_up[frame] += len(times)

    def _remove(self, frame: Frame) -> bool:
        times = self._pending.get(frame)
        if not times:
            return False
        del times[0]
        self._count -= 1
        if not times:
            del self._pending[frame]
        return True
