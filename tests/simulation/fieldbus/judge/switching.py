"""Switching: the RPDOs and SYNCs of each command, what they change, and what the master tells of it."""

from __future__ import annotations

from typing import NamedTuple

from tests.simulation.fieldbus.judge.wires import INVALID, JudgedBoard, JudgedWiring, Look, bits_in
from tests.simulation.verdict import require

Key = tuple[str, int]  # bus and COB-ID
SYNC = 0x080
AT_ONCE = 0.004  # [s] from a SYNC on the bus until the master tells the switch


class Part(NamedTuple):
    """A board's share of a frame."""

    board: JudgedBoard
    mapping: tuple[int, ...]
    waits: bool  # for SYNC


class Switching:
    """Judges commands.

    Attributes:
        echoing: whether the master gets its own frames back.
        states: levels of all output lines, as commanded and as found by the last boot.
    """

    def __init__(self, wiring: JudgedWiring, looks: dict[str, Look]) -> None:
        self._wiring, self._looks = wiring, looks
        self.states = 0
        self._frames: dict[Key, list[Part]] = {}
        self._latched: dict[Key, bytes | None] = {}
        self._awaited: dict[Key, bytes] = {}
        self._optional: dict[Key, bytes] = {}
        self._unsure: set[Key] = set()  # frames that the boards may have latched already
        self._unechoed: set[Key] = set()
        self._syncs: set[str] = set()
        self._before = self._wanted = 0
        self._together = True
        self.idle = self.echoing = True
        self.synced: dict[str, float] = {}

    def booted(self) -> None:
        """All boards are ready: their pins are the states."""
        self._frames = {}
        for board in self._wiring.boards.values():
            look = self._looks[board.name]
            for index in range(0x1400, 0x1420):
                cob_id = look.number(index, 1)
                if not look.has(index) or cob_id & INVALID:
                    continue
                mapping = tuple(look.number(index + 0x200, 1 + k) for k in range(look.number(index + 0x200, 0)))
                ours = (cob_id & 0x7FF) in [pdo.cob_id for pdo in board.rpdos] or (cob_id & 0x7F) == board.node
                if bits_in(mapping, board.base) & board.used and ours:
                    part = Part(board, mapping, look.number(index, 2) <= 240)
                    self._frames.setdefault((board.bus, cob_id & 0x7FF), []).append(part)
        self._latched = dict.fromkeys(self._frames)
        self.states = self.driven()
        self._awaited, self._optional, self._syncs, self.idle = {}, {}, set(), True
        self._unechoed, self._unsure = set(), set()

    def driven(self) -> int:
        states = 0
        for board in self._wiring.boards.values():
            pins = self._looks[board.name].pins()
            states |= sum(wire.line for wire in board.outputs if bool(pins >> wire.bit & 1) != wire.inverted)
        return states

    def _lines(self, key: Key) -> int:
        found = 0
        for board, mapping, _ in self._frames[key]:
            bits = bits_in(mapping, board.base)
            found |= sum(wire.line for wire in board.outputs if bits >> wire.bit & 1)
        return found

    def _data(self, key: Key, states: int) -> bytes:
        """Returns the bytes of a frame for states: used bits by the states, all else as the boards have it."""
        value = size = 0
        for board, mapping, _ in self._frames[key]:
            levels, place, look = board.levels_of(states), 0, self._looks[board.name]
            for entry in mapping:
                index, sub, count = entry >> 16, entry >> 8 & 0xFF, entry & 0xFF
                if index > 7:
                    part = look.number(index, sub)
                    if index == board.base:
                        used = board.used >> 8 * (sub - 1) & 0xFF
                        part = part & ~used | levels >> 8 * (sub - 1) & used
                    value |= part << place
                place += count
            size = max(size, (place + 7) // 8)
        return value.to_bytes(size, "little")

    def commands(self, states: int, off: int = 0) -> None:
        """The master is asked to switch to states; `off`: it only switches these lines off."""
        self._before, self._wanted, self._together = self.states, states, not off
        self._awaited, self._optional, self._syncs, self.synced = {}, {}, set(), {}
        self._unechoed = set()
        stale: list[Key] = []
        for key, parts in self._frames.items():
            wanted, latched, lines = self._data(key, states), self._latched[key], self._lines(key)
            waits = all(part.waits for part in parts)
            if off:
                concerned = bool(lines & off)
            else:
                concerned = bool(lines & (states ^ self.states)) or (waits and latched not in (None, wanted))
            if concerned:
                self._syncs.add(key[0])
            if wanted != latched or lines & off:
                stale.append(key)
        for key in stale:
            unchanged = key in self._unsure and not self._lines(key) & (states ^ self.states | off)
            if key[0] in self._syncs:
                (self._optional if unchanged else self._awaited)[key] = self._data(key, states)
        self.idle = not self._syncs

    def hands_out(self, bus: str, cob_id: int, data: bytes) -> None:
        key = bus, cob_id
        if cob_id == SYNC:
            require(bus in self._syncs and data == b"", f"{bus}: a SYNC {data.hex()} that no command needs")
            here = [k for k in (*self._awaited, *self._unechoed) if self._together or k[0] == bus]
            require(not here, f"{bus}: a SYNC before the RPDOs {here} were sent")
            self._syncs.remove(bus)
            return
        wanted = self._awaited.pop(key, None) or self._optional.pop(key, None)
        told = "none" if wanted is None else wanted.hex()
        require(data == wanted, f"{bus}: RPDO {cob_id:03X}h is {data.hex()}; {told} is commanded")
        self._latched[key] = data
        self._unsure.discard(key)
        if self.echoing:
            self._unechoed.add(key)

    def echoes(self, bus: str, cob_id: int, now: float) -> None:
        self._unechoed.discard((bus, cob_id))
        if cob_id == SYNC:
            self.synced[bus] = now

    def forget(self, states: int) -> None:
        """A command that was not followed frame by frame has ended with these states."""
        self.booted()
        self.states, self._unsure = states, set(self._frames)

    def parts_of(self, name: str) -> list[Part]:
        return [part for parts in self._frames.values() for part in parts if part.board.name == name]

    def lines_on(self, bus: str) -> int:
        return sum(board.lines for board in self._wiring.boards.values() if board.bus == bus)

    def ended(self, outputs: int, switched: list[tuple[int, float]], failed: str | None) -> None:
        """The command has ended: the master tells outputs, switches with their times, and a failure."""
        require(not self._awaited and not self._syncs, f"the command ends without {self._awaited}, SYNC {self._syncs}")
        driven = self.driven()
        require(driven == self._wanted, f"the pins are {driven:b} after a command of {self._wanted:b}")
        require(outputs == driven, f"outputs are told as {outputs:b}, the pins are {driven:b}")
        require(failed is None, f"a command has failed: {failed}")
        told = 0
        for mask, at in switched:
            require(not told & mask, f"{mask:b} is told twice: {switched}")
            told |= mask
            near = not self.echoing or any(abs(at - when) <= AT_ONCE for when in self.synced.values())
            require(near or not self._only_sync(mask), f"{mask:b} switched at {at:.4f}, SYNCs {self.synced}")
        changed = self._before ^ self._wanted
        require(told == changed, f"{told:b} is told as switched; {changed:b} has")
        self.states, self.idle = self._wanted, True

    def _only_sync(self, mask: int) -> bool:
        return all(part.waits for key, parts in self._frames.items() if self._lines(key) & mask for part in parts)
