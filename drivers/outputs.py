"""The bytes the boards were last sent, and which frames a change of states takes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from drivers import cia301
from drivers.bus import CanBus
from drivers.layout import Board, Frame, Layout


class Outputs:
    """All boards' output bytes, as latched by their RPDOs and as switched by SYNC.

    Attributes:
        image: all boards' output bytes as of the last SYNC.
    """

    def __init__(self, layout: Layout) -> None:
        self.image = np.zeros(layout.size, dtype=np.uint8)
        self._layout = layout
        # What waits in the boards for the next SYNC; None: not known, so it is sent again before any SYNC.
        self._latched: list[bytes | None] = [None] * len(layout.frames)
        self._ours = np.zeros(layout.size, dtype=np.uint8)
        np.bitwise_or.at(self._ours, layout.byte, np.left_shift(1, layout.bit, dtype=np.uint8))

    def adopt(self, board: Board, values: bytes) -> None:
        """Takes over the output bytes read back from a board, which may hold bits that are not ours."""
        self.image[board.image] = np.frombuffer(values, np.uint8)
        for i, frame in enumerate(self._layout.frames):
            if frame.image.start <= board.image.start < frame.image.stop:
                self._latched[i] = None

    def states(self) -> NDArray[np.uint8]:
        """(A,) the actuators' outputs as of the last SYNC."""
        return (self.image[self._layout.byte] >> self._layout.bit & 1).astype(np.uint8)

    def wanted(self, states: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """The image that (A,) `states` make; bits that are no actuator's stay as they are."""
        image = self.image & ~self._ours
        np.bitwise_or.at(image, self._layout.byte, np.left_shift(states, self._layout.bit, dtype=np.uint8))
        return image

    def due(self, wanted: NDArray[np.uint8]) -> dict[str, list[Frame]]:
        """The frames to send before a SYNC, for each bus that needs one.

        A bus where something is to switch also gets the frames whose latched bytes are not known or not those wanted,
        since its SYNC would switch them, too.
        """
        buses = set()
        stale: list[Frame] = []
        for frame, latched in zip(self._layout.frames, self._latched, strict=True):
            new = wanted[frame.image].tobytes()
            if new != self.image[frame.image].tobytes() or latched not in (None, new):
                buses.add(frame.bus)
            if new != latched:
                stale.append(frame)
        return {f.bus: [s for s in stale if s.bus == f.bus] for f in self._layout.frames if f.bus in buses}

    def latch(self, bus: CanBus, frame: Frame, wanted: NDArray[np.uint8]) -> None:
        """Sends one frame.

        Raises:
            BusBusy: it could not be queued.
        """
        data = wanted[frame.image].tobytes()
        place = self._layout.frames.index(frame)
        self._latched[place] = None  # until it is surely sent
        bus.send(cia301.frame(frame.cob_id, data))
        self._latched[place] = data

    def switched(self, bus: str, wanted: NDArray[np.uint8]) -> NDArray[np.bool_]:
        """Notes that the SYNC of a bus has left, and the boards on it have switched.

        Returns:
            (A,) which actuators switched by it.
        """
        before = self.states()
        for frame in self._layout.frames:
            if frame.bus == bus:
                self.image[frame.image] = wanted[frame.image]
        return np.not_equal(self.states(), before)
