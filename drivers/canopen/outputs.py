"""Output bytes of all boards: as switched by the last SYNC, and as latched in the boards for the next."""

from __future__ import annotations

from drivers.canopen.cia301 import Frame
from drivers.canopen.layout import BoardLayout, Layout, RpdoFrame


class Outputs:
    """The outputs of all boards.

    The bytes of a frame are one little-endian number. Bits that are no actuator's keep the value that was read back.

    Attributes:
        states: actuator states as of the last SYNC.
    """

    def __init__(self, layout: Layout) -> None:
        self.states = 0
        self._frames = layout.frames
        self._actuators = sum(frame.actuators for frame in layout.frames)
        self._image = [0] * len(layout.frames)
        # What the boards take over with the next SYNC. None: unknown, so the frame is sent before any SYNC.
        self._latched: list[int | None] = [None] * len(layout.frames)
        self._uncertain: set[int] = set()  # frames that may have left: they may switch with the next SYNC

    def adopt(self, board: BoardLayout, values: bytes) -> None:
        """Takes over the output bytes that were read back from a board."""
        shift = 8 * board.offset
        mask = (1 << 8 * len(values)) - 1 << shift
        image = self._image[board.frame] & ~mask | int.from_bytes(values, "little") << shift
        self._image[board.frame] = image
        self._latched[board.frame] = None
        self._uncertain.discard(board.frame)
        self.states = self.states & ~board.actuators | _states(self._frames[board.frame], image) & board.actuators

    def due(self, states: int) -> dict[str, list[int]]:
        """Returns indices of the frames to send before a SYNC, for each bus that needs a SYNC.

        A bus needs a SYNC if an output changes on it, or if its boards have latched other bytes. Then all frames whose
        latched bytes are unknown or others are sent, for the SYNC switches them as well.

        Raises:
            ValueError: a bit of `states` is no actuator's.
        """
        if states & ~self._actuators or states < 0:
            raise ValueError(f"states {states:#x}: there are {self._actuators.bit_count()} actuators")
        buses: set[str] = set()
        stale: list[int] = []
        changed = states ^ self.states
        for i, frame in enumerate(self._frames):
            image, latched = self._image[i], self._latched[i]
            wanted = self._wanted(i, states) if changed & frame.actuators else image
            if wanted != image or latched not in (None, wanted) or i in self._uncertain:
                buses.add(frame.bus)
            if wanted != latched:
                stale.append(i)
        due: dict[str, list[int]] = {frame.bus: [] for frame in self._frames if frame.bus in buses}
        for i in stale:
            if self._frames[i].bus in buses:
                due[self._frames[i].bus].append(i)
        return due

    def frame(self, i: int, states: int) -> Frame:
        """Returns frame `i` for the states."""
        frame = self._frames[i]
        return Frame(frame.cob_id, self._wanted(i, states).to_bytes(frame.size, "little"))

    def sending(self, i: int) -> None:
        """Notes that frame `i` is on its way: what is latched is unknown until `sent`."""
        self._latched[i] = None
        self._uncertain.add(i)

    def sent(self, i: int, frame: Frame) -> None:
        """Notes that frame `i` has left."""
        self._latched[i] = int.from_bytes(frame.data, "little")
        self._uncertain.discard(i)

    def switched(self, bus: str, states: int) -> int:
        """Notes that the SYNC of a bus has left; returns the mask of the actuators that it switched."""
        before = self.states
        for i, frame in enumerate(self._frames):
            if frame.bus == bus:
                self._image[i] = self._wanted(i, states)
                self.states = self.states & ~frame.actuators | states & frame.actuators
        return before ^ self.states

    def _wanted(self, i: int, states: int) -> int:
        """The bytes of frame `i` for the states."""
        frame = self._frames[i]
        image = self._image[i] & ~frame.used
        for actuator, mask, place in frame.runs:
            image |= (states >> actuator & mask) << place
        return image


def _states(frame: RpdoFrame, image: int) -> int:
    return sum(bit.actuator for bit in frame.bits if image & bit.place)
