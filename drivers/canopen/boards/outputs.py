"""Output lines of all boards: what is believed of each, and the bytes of the RPDOs that carry them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from hyperbit.drivers.canopen.layout import BoardLayout, Layout
from hyperbit.drivers.canopen.pdo import Bit, Carried, Pdo, carries, union
from hyperbit.drivers.canopen.wire.cia301 import Frame

Key = tuple[str, int]  # bus and COB-ID of a frame


@dataclass(frozen=True)
class RpdoFrame:
    """One RPDO frame of the master, which several boards may receive. Its bytes are one little-endian number."""

    bus: str
    cob_id: int
    size: int  # [bytes]
    on_sync: bool  # whether the boards apply it at the next SYNC, not at once
    boards: frozenset[int]  # indices of the boards that receive it
    bits: tuple[Bit, ...]  # its lines, and their bits in the number
    lines: int  # mask of the lines
    used: int  # mask of their bits


def assemble(boards: Iterable[BoardLayout], rpdos: Mapping[int, tuple[Pdo, ...]]) -> list[RpdoFrame]:
    """Returns the frames for the boards' RPDOs, one for each bus and COB-ID; `rpdos`: by index of the board."""
    takers: dict[Key, list[tuple[int, BoardLayout, Pdo]]] = {}
    for i, board in enumerate(boards):
        for pdo in rpdos.get(i, ()):
            takers.setdefault((board.bus, pdo.cob_id), []).append((i, board, pdo))
    frames = []
    for (bus, cob_id), taking in takers.items():
        bits: list[Bit] = []
        for _, board, pdo in taking:
            carried = carries(pdo.mapping, board.settings.object)
            bits += [bit._replace(place=place) for bit in board.outputs if (place := _placed(bit.place, carried))]
        size = max(pdo.size for _, _, pdo in taking)
        on_sync = all(pdo.on_sync for _, _, pdo in taking)
        lines, used = union(bit.line for bit in bits), union(bit.place for bit in bits)
        takes = frozenset(i for i, _, _ in taking)
        frames.append(RpdoFrame(bus, cob_id, size, on_sync, takes, tuple(bits), lines, used))
    return frames


def _placed(bit: int, carried: Iterable[Carried]) -> int:
    """Returns the mask of a board's bit in a PDO; 0 if the PDO does not carry it."""
    number = bit.bit_length() - 1
    return union(1 << c.place + number - c.bit for c in carried if c.bit <= number < c.bit + c.width)


class OutputLines:
    """The belief about the output lines of all boards, as masks, and the bytes of their RPDOs.

    Bits of frames without a line keep the value that was read back.
    """

    def __init__(self, layout: Layout, pulsed: int) -> None:
        self.pulsed = pulsed  # mask of the lines with pulses
        self.blind = 0  # mask of the lines of which no believed end-stop tells
        self.commanded = 0  # levels after the last SYNC that was sent, or as a boot has read them
        self.unread = 0  # mask of the lines that have switched, and were not read back since
        # May be on: the bus was lost while their frames were being sent, or the end of a pulse was not read back.
        self.doubtful = 0
        self.missed = 0  # mask of the lines whose pulse was not read back while on, until `drain_missed`
        self.unanswered = 0  # the same until their board answers
        self._boards = layout.boards
        self._moved = [0] * len(layout.boards)  # lines of each board that may have changed since `begin_read`
        self._trusted = union(board.output_lines for board in layout.boards if not board.settings.verify)
        self._lines = union(board.output_lines for board in layout.boards)
        self._rpdos = {i: board.rpdos for i, board in enumerate(layout.boards)}
        self.frames: dict[Key, RpdoFrame] = {}
        self._image: dict[Key, int] = {}
        # The bytes that the boards apply at the next SYNC. None: unknown, so the frame is sent before any SYNC.
        self._latched: dict[Key, int | None] = {}
        self._uncertain: set[Key] = set()  # frames with unconfirmed sending: the next SYNC may apply them
        self._assemble()
        self.believe(True)

    def believe(self, ends: bool) -> None:
        """Believes the end-stops, or takes each line for one without."""
        self.blind = self._lines & ~(union(board.sensed for board in self._boards) if ends else 0)

    @property
    def released(self) -> int:
        """Mask of the lines whose pulse has ended, and which were not read back as off."""
        return self.unread & self.pulsed & ~self.commanded

    @property
    def unproven(self) -> int:
        """Mask of the blind lines that were switched and not read back, and of missed pulses; no ends of pulses."""
        return (self.unread & ~self.released | self.missed) & self.blind

    def drain_missed(self) -> int:
        """Returns, since the last call, the blind lines whose pulse ended before it was read."""
        missed, self.missed = self.missed, 0
        return missed & self.blind

    def adopt(self, i: int, rpdos: tuple[Pdo, ...], values: Mapping[int, int]) -> None:
        """Sets the RPDOs of board `i`, and the read-back values, by mapping entry."""
        if self._rpdos[i] != rpdos:
            self._rpdos[i] = rpdos
            self._assemble()
        board = self._boards[i]
        for pdo in rpdos:
            key, place = (board.bus, pdo.cob_id), 0
            for entry in pdo.mapping:
                count = entry & 0xFF
                if entry in values:
                    mask = (1 << count) - 1
                    self._image[key] = self._image[key] & ~(mask << place) | (values[entry] & mask) << place
                place += count
            self._latched[key] = None
            self._uncertain.discard(key)
            frame, image = self.frames[key], self._image[key]
            levels = union(bit.line for bit in frame.bits if bool(image & bit.place) != bit.inverted)
            lines = frame.lines & board.output_lines
            self._find_missed(lines)
            self.commanded = self.commanded & ~lines | levels & lines
        self.doubtful &= ~board.output_lines
        self.unread &= ~board.output_lines
        self._moved[i] = -1

    def begin_read(self, i: int) -> None:
        """Records a request of the outputs of board `i`. No frame that switches them may be under way."""
        self._moved[i] = 0

    def read(self, i: int, sub: int, byte: int) -> tuple[int, int]:
        """Takes an output byte of board `i`, requested at `begin_read`; returns its right and wrong lines.

        Lines that have switched meanwhile are in neither.
        """
        here = [bit for bit in self._boards[i].outputs if bit.place >> 8 * (sub - 1) & 0xFF]
        levels = union(bit.line for bit in here if bool(byte << 8 * (sub - 1) & bit.place) != bit.inverted)
        told = union(bit.line for bit in here) & ~self._moved[i]
        wrong = (levels ^ self.commanded) & told
        self.unread = self.unread & ~told | wrong
        return told & ~wrong, wrong

    def mistrust(self, lines: int) -> None:
        """Records that lines whose pulse has ended may be on. Their frames are sent again."""
        self.doubtful |= lines
        for key, frame in self.frames.items():
            if frame.lines & lines:
                self._latched[key] = None

    def due(self, states: int, released: int = 0) -> dict[str, list[Key]]:
        """Returns the frames to send before a SYNC, for each bus that needs a SYNC.

        A bus needs a SYNC if an output changes on it, or if its boards have latched other bytes. The SYNC then applies
        all latched bytes, so frames with unknown or other latched bytes are sent too. If lines are `released`, only
        their buses get a SYNC, and their frames are always sent.

        Raises:
            ValueError: `states` has a bit that is no line.
        """
        if states & ~self._lines or states < 0:
            raise ValueError(f"outputs {states:#x}: there are {self._lines.bit_count()} lines")
        buses: set[str] = set()
        stale: dict[str, list[Key]] = {}
        changed = states ^ self.commanded
        for key, frame in self.frames.items():
            image, latched, keys = self._image[key], self._latched[key], stale.setdefault(frame.bus, [])
            wanted = self._wanted(key, states) if changed & frame.lines else image
            waits = frame.on_sync and latched not in (None, wanted)
            if frame.lines & released if released else wanted != image or waits or key in self._uncertain:
                buses.add(frame.bus)
            if wanted != latched or frame.lines & released:
                keys.append(key)
        return {bus: keys for bus, keys in stale.items() if bus in buses}

    def send(self, key: Key, states: int) -> Frame:
        """Returns the frame for these levels. The caller sends it: the latched bytes are unknown until `sent`."""
        self._latched[key] = None
        self._uncertain.add(key)
        self._move(self.frames[key], states ^ self.commanded)
        return Frame(key[1], self._wanted(key, states).to_bytes(self.frames[key].size, "little"))

    def sent(self, key: Key, frame: Frame, states: int) -> int:
        """Records that a frame was sent; returns the mask of the lines that it switched without SYNC."""
        self._latched[key] = int.from_bytes(frame.data, "little")
        self._uncertain.discard(key)
        return 0 if self.frames[key].on_sync else self._switch(key, states)

    def switched(self, bus: str, states: int) -> int:
        """Records that the SYNC of a bus was sent; returns the mask of the lines that it switched."""
        lines = self.lines_of(bus)
        self.unread |= self.doubtful & lines
        self.doubtful &= ~lines
        return union(self._switch(key, states) for key in self.frames if key[0] == bus)

    def written_off(self, lines: int) -> int:
        """Records that lines were written off by SDO, and read back; returns the mask of those that were on."""
        switched = self.commanded & lines
        self._find_missed(lines)
        self.commanded &= ~lines
        self.unread &= ~lines
        self.doubtful &= ~lines
        for key, frame in self.frames.items():
            for bit in frame.bits if frame.lines & lines else ():
                if bit.line & lines:
                    self._image[key] = self._image[key] & ~bit.place | bit.place * bit.inverted
            if frame.lines & lines:
                self._latched[key] = None
        return switched

    def bus_lost(self, bus: str, leaving: int) -> None:
        """Records the loss of a bus; frames under way may have switched the lines `leaving`."""
        self.doubtful |= leaving | self.released & self.lines_of(bus)
        self._latched |= {key: None for key in self.frames if key[0] == bus}

    def lines_of(self, bus: str) -> int:
        return union(frame.lines for frame in self.frames.values() if frame.bus == bus)

    def bits(self, i: int) -> int:
        """Returns the expected levels of the used output bits of board `i`."""
        return union(b.place for b in self._boards[i].outputs if bool(self.commanded & b.line) != b.inverted)

    def _switch(self, key: Key, states: int) -> int:
        frame, before = self.frames[key], self.commanded
        self._image[key] = self._wanted(key, states)
        self._find_missed(frame.lines & ~states)
        self.commanded = before & ~frame.lines | states & frame.lines
        if switched := before ^ self.commanded:
            self._move(frame, switched)
            self.unread |= switched & (~self._trusted | self.pulsed & ~self.commanded)
        return switched

    def _find_missed(self, lines: int) -> None:
        """Finds missed pulses: on lines that go off, or are read, and were not read back while they were on."""
        missed = lines & self.pulsed & self.commanded & self.unread & ~self._trusted
        self.missed |= missed
        self.unanswered |= missed

    def _move(self, frame: RpdoFrame, lines: int) -> None:
        for i in frame.boards:
            self._moved[i] |= lines

    def _assemble(self) -> None:
        self.frames = {(frame.bus, frame.cob_id): frame for frame in assemble(self._boards, self._rpdos)}
        self._image = {key: self._image.get(key, 0) for key in self.frames}
        self._latched = {key: self._latched.get(key) for key in self.frames}
        self._uncertain &= set(self.frames)

    def _wanted(self, key: Key, states: int) -> int:
        frame = self.frames[key]
        levels = union(bit.place for bit in frame.bits if bool(states & bit.line) != bit.inverted)
        return self._image[key] & ~frame.used | levels
