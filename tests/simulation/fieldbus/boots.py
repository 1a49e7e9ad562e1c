"""The statement on boots, and the reasons for which a boot may refuse a board."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from hyperbit.drivers.canopen.wire import cia301
from hyperbit.drivers.canopen.wire.cia301 import Command, Frame
from tests.simulation.faults.sight import OPERATIONAL, PRE_OPERATIONAL, STOPPED, Found
from tests.simulation.fieldbus.statements import READS, OfBoards
from tests.simulation.statements.boards import INPUTS, OUTPUTS, JudgedBoard, bytes_of
from tests.simulation.statements.objects import LIVE, Values, heartbeats, needs_of

if TYPE_CHECKING:
    from tests.simulation.fieldbus.life import Life

PROFILE, NO_PROFILES = 0x191, (0, 0xFFFF)  # in 1000h
READY = "ready"


class BootsAreSound(OfBoards):
    """A boot makes a board ready, or tells one fault that has a reason, and leaves the board as it was.

    A ready board is operational, and has the objects that it needs. One that is right gets no command and no write.
    Outputs are written off where the board may have switched them itself, and this is warned of.

    Attributes:
        found: the boards as the present boot found them.
        left: objects of each board after its last boot.
        failed: boards whose last boot by this master has failed, perhaps after outputs were written.
    """

    number = 17

    def __init__(self, life: Life) -> None:
        super().__init__(life)
        self.found: dict[str, Found] = {}
        self.left: dict[str, Values] = {}
        self.failed: set[str] = set()
        self._touched: dict[str, list[str]] = {}
        self._written: dict[str, set[bytes]] = {}  # objects of each board that were not read since their write

    def begin(self, found: dict[str, Found]) -> None:
        self.found, self._touched = found, {name: [] for name in found}
        self._written = {name: set() for name in found}

    def again(self, name: str) -> None:
        """A board has restarted during the boot."""
        self.found[name], self._touched[name], self._written[name] = self.life.sight.found(name), [], set()

    def sends(self, bus: str, frame: Frame) -> None:
        name, index = f"{bus}/{frame.id & 0x7F}", int.from_bytes(frame.data[1:3], "little")
        if frame.id & ~0x7F == cia301.SDO_REQUEST and name in self._written:
            place, written = frame.data[1:4], self._written[name]
            if frame.data[0] == 0x40:
                written.discard(place)
            elif frame.data[0] & 0xE0 == 0x20:
                written.add(place)
        if frame.id == cia301.NMT:
            self._touched.setdefault(f"{bus}/{frame.data[1]}", []).append(f"NMT {frame.data[0]}")
        elif frame.id & ~0x7F == cia301.SDO_REQUEST and frame.data[0] not in READS and name in self.found:
            asks = index & 0xFF00 == 0x1400 and frame.data[3] == 2  # whether an RPDO may wait for SYNC
            if self.found[name].synchronous or not asks:
                self._touched[name].append(frame.data.hex())

    def end(self, faults: list[Any], warnings: list[Any], ready: bool) -> None:
        """The boot is over: it has faults and warnings, and `ready` is whether the master says that it is."""
        self.require(ready == (not faults), f"ready is {ready} with {faults}")
        others = [fault for fault in faults if fault.source not in self.found]
        self.require(not others, f"a boot without trouble ends with {others}")
        for name, found in self.found.items():
            board = self.life.judged.boards[name]
            told, expected = [fault.code for fault in faults if fault.source == name], outcomes(board, found)
            right = len(told) <= 1 and {*(told or [READY])} <= expected
            self.require(right, f"{name}: {faults}; {expected} is expected")
            off = any((one.code, one.source) == ("outputs-off", name) for one in warnings)
            if not told:
                self._judge_ready(board, found, off)
            elif told != ["board-missing"]:
                self._judge_refused(board, found)
            (self.failed.add if told else self.failed.discard)(name)

    def _judge_refused(self, board: JudgedBoard, found: Found) -> None:
        now = self.life.sight.found(board.name)
        changed = {
            (f"{index:04X}h", sub): (value, now.byte(index, sub))
            for (index, sub), value in found.values.items()
            if index not in LIVE
            and index != board.base
            and now.byte(index, sub) != value
            and not (0x1600 <= index < 0x1C00 and index & 0x200 and sub > found.byte(index, 0))  # not in use
        }
        self.require(not changed, f"{board.name} was refused, and is changed: {changed}")
        self._judge_outputs(board, found, now)
        unread = any(index == board.base for index, _ in found.refused)
        states = {found.state} | ({PRE_OPERATIONAL} if unread or not found.starts else set())
        self.require(
            now.state in states, f"{board.name} was found in {found.state}, was refused, and is in {now.state}"
        )

    def _judge_ready(self, board: JudgedBoard, found: Found, off: bool) -> None:
        name, life, touched = board.name, self.life, self._touched[board.name]
        now = life.sight.found(name)
        self.require(now.state == OPERATIONAL, f"{name} is told as ready, and is in {now.state}")
        life.objects.judge(name)
        life.objects.judge_kept(name, found.values, now.values)
        unread = [place.hex() for place in self._written[name]] if touched else []  # it was configured
        self.require(not unread, f"{name} is ready, and {unread} were written and not read back")
        written = self._judge_outputs(board, found, now)
        right = off == written or (off and name in self.failed)
        self.require(right, f"{name}: outputs-off is warned: {off}, outputs were written: {written}")
        if found.state == OPERATIONAL and found.values == self.left.get(name):
            fell = (
                not heartbeats(found.has) and f"NMT {Command.PRE_OPERATIONAL}" not in touched
            )  # nobody had guarded it
            self.require(fell or not touched, f"{name} is operational and right, and gets {touched}")

    def _judge_outputs(self, board: JudgedBoard, found: Found, after: Found) -> bool:
        """Requires that outputs were only written off where the board may have switched them; returns whether any."""
        written = False
        for sub in range(1, 1 + found.byte(board.base, 0)):
            mask, level = may_have_switched(board, found, sub)
            was, now = found.byte(board.base, sub), after.byte(board.base, sub)
            text = (
                f"{board.name}: {board.base:04X}h sub {sub} was {was:02X}h, is {now:02X}h; {mask:02X}h may be written"
            )
            self.require(not (was ^ now) & (~mask | now ^ level), text)
            written |= was != now
        return written


def may_have_switched(board: JudgedBoard, found: Found, sub: int) -> tuple[int, int]:
    """Returns the bits of an output byte whose pins may differ from it, and what a boot then writes."""
    told = board.base == OUTPUTS and found.has(0x6206, 1)
    mask = found.byte(0x6206, sub) if told else 0 if board.error_state == "hold" else 0xFF
    leaves = found.byte(0x1029, 1) in (0, 2)  # operational, when the board loses its master
    if found.state == OPERATIONAL and told and (leaves or found.explained):
        mask &= ~board.used >> 8 * (sub - 1)  # the boot makes them hold before they leave operational
    known = found.state == STOPPED and told and found.has(0x6207, 1)
    return mask & 0xFF, found.byte(0x6207, sub) if known else board.off >> 8 * (sub - 1) & 0xFF


def outcomes(board: JudgedBoard, found: Found) -> set[str]:
    """Returns what may become of a board: codes of faults, and "ready"."""
    if found.state is None:
        return {"board-missing"}
    codes = set[str]()
    if _is_another_device(board, found) or _cannot_be_made_safe(board, found):
        codes.add("wrong-device")
    if found.state == STOPPED and not found.tells:  # a board may answer polls also without the objects for them
        return codes | {"board-missing"}
    needs = needs_of(board, found.has)
    wrong = [place for place, (value, mask) in needs.items() if (found.byte(*place) ^ value) & mask]
    if found.refused or not found.writable.issuperset(wrong):
        codes.add("sdo-refused")
    if board.shares and (0x1600, 1) not in found.writable:
        codes.add("sdo-refused")
    if not found.starts:
        codes.add("board-stopped")
    history = [found.byte(0x1003, sub) & 0xFFFF for sub in range(1, 1 + found.byte(0x1003, 0))]
    unexplained = not found.explained and not found.has(0x1003)  # nothing tells another cause than the last master
    if any(code != 0x8130 for code in found.errors):
        return codes | {"board-error"} | ({READY} if unexplained and not codes else set())
    if found.errors and found.keeps_loss:  # as far as the master knows, perhaps there was another error before
        return codes | {"board-error"} | (set() if codes or {*history} - {0, 0x8130} else {READY})
    return codes or {READY}


def _is_another_device(board: JudgedBoard, found: Found) -> bool:
    kind = found.byte(0x1000, 0)
    other = board.base == OUTPUTS and kind & 0xFFFF != PROFILE
    there = found.byte(OUTPUTS if board.used else INPUTS, 0)
    short = [i for i, bits in ((board.base, board.used), (INPUTS, board.sensed)) if found.byte(i, 0) < len_of(bits)]
    differs = [sub for sub, value in board.identity.items() if found.byte(0x1018, sub) != value]
    return bool(differs or short or (other and not (kind & 0xFFFF in NO_PROFILES and there)))


def len_of(bits: int) -> int:
    return max(bytes_of(bits), default=0)


def _cannot_be_made_safe(board: JudgedBoard, found: Found) -> bool:
    """Returns whether a board is unsupervised, inverts outputs, or cannot be told what to do without the master."""
    unsupervised = not heartbeats(found.has) and not (found.has(0x100C) and found.has(0x100D))
    if unsupervised or not board.used:
        return unsupervised
    is_usual, state = board.base == OUTPUTS, board.error_state
    inverted = is_usual and any(
        found.byte(0x6202, sub) & board.used >> 8 * (sub - 1) & 0xFF for sub in bytes_of(board.used)
    )
    needed = bool(board.taken) and not (state == "off" and board.levels == 0)  # else they go off by themselves
    modes = is_usual and found.has(0x6206, 1)
    unsafe = needed and not (modes and found.has(0x6207, 1))
    untold = not modes and state is None
    unled = bool(board.taken) and modes and not found.has(0x1029, 1)
    places = [{bytes_of(board.used).index(1 + bit // 8) // 8 for bit in pair} for pair in board.pairs]
    apart = not found.synchronous and found.has(0x1005) and any(len(place) > 1 for place in places)
    return inverted or unsafe or untold or unled or apart
