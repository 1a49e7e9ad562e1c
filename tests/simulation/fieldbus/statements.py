"""Statements on boards and their master: pins, coils, frames, heartbeats, and what the master tells."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from hyperbit.drivers.canopen.wire import cia301
from hyperbit.drivers.canopen.wire.cia301 import Frame
from tests.simulation.fieldbus.site import TICK, TOOL
from tests.simulation.statements.statement import Statement

if TYPE_CHECKING:
    from tests.simulation.fieldbus.life import Life

RPDOS, MASTER = range(0x200, 0x580), 0x77F  # COB-IDs
READS = (0x40, 0x60, 0x70, 0x80)  # first bytes of SDO requests that write nothing


class OfBoards(Statement):
    """A statement on the boards and the master of one arm."""

    def __init__(self, life: Life) -> None:
        account: Any = life
        super().__init__(account)
        self.life = life


class PinsHaveACause(OfBoards):
    """Each change of a pin has a cause: a command, a release, the loss of the master, supply, or another program.

    SDO and NMT commands of the master only switch off. A board that has missed its command follows it at a later SYNC.
    """

    number = 1

    def pins(self, name: str, before: int, after: int, cause: str, of_command: bool) -> None:
        life, board, changed = self.life, self.life.judged.boards[name], before ^ after
        text, rises = f"{name}: pins {before:b} become {after:b} by {cause}", changed & after & ~board.off
        switched = cause in ("SYNC", "RPDO")
        self.require(cause != "frame" and not (cause in ("SDO", "NMT") and rises), text)
        self.require(switched or not (life.ready and life.calm), text)
        if switched:
            ends = sum(1 << wire.bit for wire in board.outputs if wire.line & life.released)
            late = (after ^ life.asked[name]) & board.used
            right = of_command or not (changed & ~ends | rises & ends) & late
            self.require(right, f"{text} of a release")
            self.require(not life.calm or not changed & ~board.used, f"{text}; {board.used:b} are used")


class NoCoilComesOnBesideTheOther(OfBoards):
    """No frame of the master switches a coil on while the other one of its actuator is on."""

    number = 7

    def pins(self, name: str, before: int, after: int, cause: str, of_command: bool) -> None:
        board = self.life.judged.boards[name]
        on, came = after ^ board.off, (before ^ after) & (after ^ board.off)
        pairs = [(a, b) for a, b in board.pairs if on >> a & on >> b & (came >> a | came >> b) & 1]
        self.require(not pairs or cause in (TOOL, "foreign", "fault"), lambda: f"{name}: {pairs} are on by {cause}")


class SyncsWaitForAllRpdos(OfBoards):
    """A SYNC leaves when all RPDOs of its command were sent, on all buses; that of a release waits for its own bus."""

    number = 7

    def __init__(self, life: Life) -> None:
        super().__init__(life)
        self._waiting: set[tuple[str, int]] = set()

    def begins(self) -> None:
        self._waiting.clear()

    def sends(self, bus: str, frame: Frame) -> None:
        if frame.id in RPDOS:
            self._waiting.add((bus, frame.id))
        elif frame.id == cia301.SYNC and self.life.ready and self.life.calm:
            waiting = [place for place in self._waiting if self.life.stage or place[0] == bus]
            self.require(not waiting, f"{bus}: a SYNC before the RPDOs {waiting} were sent")

    def leaves(self, bus: str, frame: Frame, missing: int) -> None:
        self._waiting.discard((bus, frame.id))


class RpdosAreNeeded(OfBoards):
    """While nothing disturbs the arm, an RPDO that a command has sent leaves again only if it switches an output."""

    number = 1

    def __init__(self, life: Life) -> None:
        super().__init__(life)
        self._known: set[tuple[str, int]] = set()
        self._sent: set[tuple[str, int]] = set()

    def begins(self) -> None:
        self._known.clear()

    def readies(self) -> None:
        self._known.clear()

    def commands(self) -> None:
        self._sent.clear()

    def sends(self, bus: str, frame: Frame) -> None:
        if frame.id in RPDOS:
            self._sent.add((bus, frame.id))

    def switched(self, changed: int) -> None:
        for bus, cob_id in sorted(self._sent & self._known):
            lines = self.life.lines_of(bus, cob_id)
            self.require(lines & changed, f"{bus}: RPDO {cob_id:03X}h of {lines:b} for a switch of {changed:b}")
        self._known |= self._sent


class ReadyBoardsAreOnlyRead(OfBoards):
    """While all boards are ready, they get no NMT command and no write; while they boot, no RPDO and no SYNC."""

    number = 17

    def sends(self, bus: str, frame: Frame) -> None:
        if not self.life.calm:
            return
        written = frame.id & ~0x7F == cia301.SDO_REQUEST and frame.data[0] not in READS
        if self.life.ready:
            self.require(frame.id != cia301.NMT and not written, f"{bus}: {frame} while all boards are ready")
        elif self.life.master.booting.under_way:
            self.require(frame.id != cia301.SYNC and frame.id not in RPDOS, f"{bus}: {frame} in a boot")


class MasterIsHeard(OfBoards):
    """No gap in the master's heartbeats, nor in its polls of boards without heartbeats."""

    number = 9

    def __init__(self, life: Life) -> None:
        super().__init__(life)
        self._last: dict[tuple[str, int], float] = {}
        self._since = self._ready_since = 0.0

    def begins(self) -> None:
        """A time without trouble begins."""
        self._since = self.life.now
        self._last.clear()

    def readies(self) -> None:
        """All boards are ready."""
        self._ready_since = self.life.now

    def sends(self, bus: str, frame: Frame) -> None:
        if not self.life.calm or (frame.id != MASTER and not frame.id & cia301.REMOTE):
            return
        life, key = self.life, (bus, frame.id)
        gap, period = life.now - self._last.get(key, self._since - 1.0), life.timing.heartbeat
        self._last[key] = life.now
        if frame.id == MASTER:
            self.require(frame.data == b"\x05" and gap >= period - TICK, f"{bus}: {frame} {gap:g} s after another one")
        elif life.ready:
            name = f"{bus}/{frame.id & 0x7F}"
            right = frame.id & 0x780 == 0x700 and name in life.looks and life.sight.guarded(name)
            self.require(right and gap >= period / 2 - 1e-6, f"{name} is polled {gap:g} s after another poll")

    def ticks(self) -> None:
        life, period = self.life, self.life.timing.heartbeat
        for bus in life.buses:
            gap = life.now - self._last.get((bus, MASTER), self._since)
            self.require(gap <= period + 2 * TICK, f"{bus}: no heartbeat of the master for {gap:g} s")
        for name, board in life.judged.boards.items() if life.ready else ():
            if life.sight.guarded(name):
                last = self._last.get((board.bus, cia301.REMOTE | cia301.HEARTBEAT + board.node), self._ready_since)
                gap = life.now - max(last, self._ready_since)
                self.require(gap <= period + 2.5 * TICK, f"{name} is not polled for {gap:g} s")


class OutputsWereRead(OfBoards):
    """Outputs that are told as read back, and have no end-stop, were read since their switch."""

    number = 4

    def __init__(self, life: Life) -> None:
        super().__init__(life)
        self._read: set[str] = set()

    def commands(self) -> None:
        self._read.clear()

    def sends(self, bus: str, frame: Frame) -> None:
        board = self.life.judged.boards.get(f"{bus}/{frame.id & 0x7F}")
        if (
            board is not None
            and frame.id & ~0x7F == cia301.SDO_REQUEST
            and frame.data[:3] == bytes([0x40, board.base & 0xFF, board.base >> 8])
        ):
            self._read.add(board.name)

    def switched(self, changed: int) -> None:
        """Lines were switched, and time has passed."""
        master = self.life.master
        for name, board in self.life.judged.boards.items():
            told = changed & board.unsensed & ~(master.outputs.unproven | master.outputs.released)
            self.require(not told or name in self._read, f"{name}: {told:b} are told as read back, and nobody has read")


class ToldIsTrue(OfBoards):
    """What the master tells of ready boards is true: inputs, outputs, states, heartbeats. It knows nothing of others.

    An actuator is known if all its boards are ready.
    """

    number = 5

    def knows(self, lost: tuple[str, ...], why: str) -> None:
        """These boards are lost, and all others are ready."""
        boards, master = self.life.judged.boards.values(), self.life.master
        inputs = sum(board.input_lines for board in boards if board.name not in lost)
        known = self.life.judged.actuators
        for board in boards:
            known &= ~board.actuators if board.name in lost else -1
        self.require(master.outputs_known == (not lost), f"{why}: outputs are known, and {lost} are lost, or neither")
        told = master.inputs
        self.require(told.known == known, f"{why}: actuators {told.known:b} are known, {known:b} are")
        self.require(told.up == inputs, f"{why}: inputs {told.up:b} are known; {inputs:b} are")
        self.require(not told.ends & ~inputs, f"{why}: inputs {told.ends:b} are told, {inputs:b} are known")

    def tells(self) -> None:
        life, master, wiring = self.life, self.life.master, self.life.judged
        self.knows((), "ready")
        ends, outputs = master.inputs.ends, master.outputs
        self.require(ends == life.ends(), f"inputs are told as {ends:b}; they read {life.ends():b}")
        self.require(master.board_of == wiring.board_of, f"{master.board_of} are told as boards of the actuators")
        self.require(master.back, "the master is not ready")
        self.require(not outputs.doubtful, f"outputs {outputs.doubtful:b} are doubtful")
        driven = life.driven()
        self.require(outputs.commanded == driven, f"{outputs.commanded:b} are told, {driven:b} are driven")
        for told in master.status().boards:
            name, age = f"{told.bus}/{told.node}", told.heartbeat_age
            young = age is not None and -TICK <= age <= 2 * life.timing.heartbeat + 0.03
            self.require(told.state == "operational" and young, f"{name} is {told.state}, its heartbeat is {age} s old")
            kept = life.variants[name].keeps_loss
            self.require(told.emergency is None or kept, f"{name}: emergency {told.emergency} is told")


EVERY: tuple[type[OfBoards], ...] = (
    PinsHaveACause,
    NoCoilComesOnBesideTheOther,
    SyncsWaitForAllRpdos,
    RpdosAreNeeded,
    ReadyBoardsAreOnlyRead,
    MasterIsHeard,
    OutputsWereRead,
    ToldIsTrue,
)
