"""Frames and bits on one bus, counted, and how many there are a second."""

from __future__ import annotations

import can

from drivers import cia301


class Meter:
    """Counts what one bus carries.

    Attributes:
        tx_frames: frames sent.
        rx_frames: frames received.
        frames_per_second: sent and received, over about the last second.
        bits_per_second: of those frames, with as many stuff bits as there can be.
    """

    def __init__(self) -> None:
        self.tx_frames = self.rx_frames = 0
        self.frames_per_second = self.bits_per_second = 0.0
        self._tx_bits = self._rx_bits = 0
        self._counted: tuple[float, int, int] | None = None

    def sent(self, message: can.Message) -> None:
        """Counts a frame that was sent."""
        self.tx_frames += 1
        self._tx_bits += cia301.frame_bits(message)

    def received(self, message: can.Message) -> None:
        """Counts a frame that was received."""
        self.rx_frames += 1
        self._rx_bits += cia301.frame_bits(message)

    def tick(self, now: float) -> None:
        """Renews what there is a second, once a second; `now` in [s]."""
        frames, bits = self.tx_frames + self.rx_frames, self._tx_bits + self._rx_bits
        if self._counted is None:
            self._counted = now, frames, bits
        elif (elapsed := now - self._counted[0]) >= 1.0:
            self.frames_per_second = (frames - self._counted[1]) / elapsed
            self.bits_per_second = (bits - self._counted[2]) / elapsed
            self._counted = now, frames, bits
