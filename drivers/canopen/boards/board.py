"""One board: its NMT state, supervision, emergencies and inputs as received, and the procedure that runs with it."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field

from hyperbit.drivers.canopen.boards.beat_count import BeatCount
from hyperbit.drivers.canopen.faults import ArmFault, left_operational
from hyperbit.drivers.canopen.layout import BoardLayout
from hyperbit.drivers.canopen.pdo import (
    FIRST_WATCHED,
    INPUTS,
    WATCHED_BITS,
    Carried,
    Pdo,
    carries,
    first_watched,
    subs_of,
    union,
)
from hyperbit.drivers.canopen.sdo import objects
from hyperbit.drivers.canopen.sdo.client import SdoOutcome, Transfer
from hyperbit.drivers.canopen.sdo.objects import Need
from hyperbit.drivers.canopen.sdo.procedure import Procedure, Runner
from hyperbit.drivers.canopen.status import BoardStatus
from hyperbit.drivers.canopen.wire import cia301
from hyperbit.drivers.canopen.wire.cia301 import STATES, Command, State
from hyperbit.drivers.canopen.wire.link import Link
from hyperbit.drivers.canopen.wiring import WatchedObject

ERROR_REGISTER = WatchedObject(0x1001, 0)  # emergencies have its value, too
_INPUT_TIMEOUT = 0.3  # [s] for the answer with the inputs


@dataclass
class InputLines:
    """The levels of all input lines, and which boards are ready. Each board writes its own lines."""

    levels: int = 0  # as received last
    up: int = 0  # mask of the lines whose board is ready
    known: int = 0  # mask of the actuators whose boards are all ready: that of the outputs and those of the end-stops
    _missing: dict[str, int] = field(default_factory=dict)  # actuators of each board that is not ready

    @property
    def ends(self) -> int:
        """Levels; 0 where unknown."""
        return self.levels & self.up

    def set_ready(self, board: BoardLayout, ready: bool) -> None:
        if ready:
            self._missing.pop(board.name, None)
            self.up |= board.input_lines
            self.known |= board.actuators & ~union(self._missing.values())
        else:
            self._missing[board.name] = board.actuators
            self.up &= ~board.input_lines
            self.known &= ~board.actuators


class Board:
    """One board on its bus. It writes its inputs into `inputs`, and its faults to `report`."""

    def __init__(
        self, index: int, layout: BoardLayout, link: Link, inputs: InputLines, report: Callable[[ArmFault], None]
    ) -> None:
        self.index, self.layout, self.link, self.name = index, layout, link, layout.name
        self.runner = Runner(layout.node, link)
        self.questioning = self._question_again = False  # whether a question for its inputs waits for the answer
        self.state: State | None = None  # NMT state; None: unknown
        self.frames = self.boots = 0  # number of understood frames, and of boot-up messages among them
        self.guarded = False  # the master polls it by remote frames: it sends no heartbeats
        self.emergency: int | None = None  # code of the last one; None after its end
        self.emergency_register = 0  # error register in that emergency
        self.ignored_errors = 0  # bits of 1001h that are no fault, or stood already at the boot
        self.history: int | None = None  # newest entry of 1003h at the boot; None: not asked, or there is none
        self.unverified = 0  # number of switches and reads whose outputs could not be read back
        self.warnings: tuple[str, ...] = ()  # limits of the board
        self.expected: tuple[Need, ...] = ()  # values of its objects at the end of the last boot
        self.beats = BeatCount()
        self.restarted = False  # since the last boot
        self.released = False  # outputs were written off before the last start
        # Whether an NMT command 80h of another program, and nothing else, has made it leave operational, so that its
        # pins hold. None: something else may have changed them.
        self.held: bool | None = None
        self._lines, self.report = inputs, report
        self._inputs = 0
        self._brought = 0  # mask of the input bits received by TPDO since `begin_input_read`
        self._ready = self._booted = self._lost = False
        self._frames_before = 0  # number of frames when the board was lost
        self._beat_at: float | None = None
        self._toggle: int | None = None  # toggle bit of the last answer to node guarding
        self._tpdos: dict[int, tuple[int, list[Carried]]] = {}
        self.poll_due = math.inf  # time at which the watched objects are asked for [s]
        self._poll_period = 0.0
        self.unread: dict[WatchedObject, str] = {}  # why watched objects are unknown; their interlocks count as open
        self.set_tpdos(layout.tpdos)
        inputs.set_ready(layout, False)
        inputs.levels |= sum(bit.line for bit in layout.inputs if bit.inverted)

    @property
    def heard(self) -> bool:
        return self._ready or self.frames > self._frames_before

    @property
    def ready(self) -> bool:
        """Whether the board was booted and not lost since. Only then are its outputs and inputs known."""
        return self._ready

    @ready.setter
    def ready(self, ready: bool) -> None:
        self._ready = ready
        if ready:
            self._booted, self.restarted, self.held = True, False, False
        else:
            self._frames_before = self.frames
        self._lines.set_ready(self.layout, ready)

    @property
    def remembered(self) -> bool:
        """Whether its outputs are those commanded last: it has not restarted since its boot, and no boot has begun."""
        return self._booted

    @property
    def stopped(self) -> bool:
        """Whether the board is present and in state stopped: it answers no SDO."""
        return self.state is State.STOPPED and not self._lost

    def forget(self) -> None:
        """Marks outputs, inputs and NMT state as unknown until the next boot."""
        self.released &= not self._booted  # a failed boot does not count as a start
        self.ready = self._booted = False
        self.state = self.history = None

    def fail(self, code: str, text: str) -> None:
        """Marks outputs and inputs as unknown until the next boot, and reports a fault."""
        self.ready = False
        self.report(ArmFault(code, self.name, text))

    def cancel(self) -> None:
        self.runner.cancel()
        self.questioning = self._question_again = False

    def question(self, now: float) -> None:
        """Asks for the inputs; asks again after a running question, whose answer may be too old."""
        if self.questioning:
            self._question_again = True
        elif self._ready and self.layout.inputs:
            self.questioning, self._question_again = True, False
            self.runner.start(self._ask_inputs(), self._answered, now)

    def poll(self, now: float, period: float) -> None:
        """Asks for the watched objects, and sets when to ask again: `period` [s] after the answer."""
        self._poll_period, self.poll_due = period, now + period
        self.runner.start(self.ask_watched(), self._polled, now)

    def probe(self, now: float) -> None:
        """Asks for the device type, 1000h. Any answer shows that the board is back."""
        if not self.runner.running:
            self.runner.start(_ask_presence(), None, now)

    def obey(self, command: int) -> None:
        """Takes another program's NMT command to the board."""
        self.held = True if command == Command.PRE_OPERATIONAL and self.held is not None else None
        if not self._ready:
            self.state = None

    def guard(self) -> None:
        self.guarded, self._toggle = True, None

    def set_tpdos(self, tpdos: Iterable[Pdo]) -> None:
        self._tpdos = {pdo.cob_id: (pdo.size, carries(pdo.mapping, INPUTS, self.layout.watched)) for pdo in tpdos}

    @property
    def polled(self) -> bool:
        """Whether a watched object is in no TPDO."""
        carried = {each.bit for _, bits in self._tpdos.values() for each in bits}
        return any(first_watched(k) not in carried for k in range(len(self.layout.watched)))

    def begin_input_read(self) -> None:
        """Records a request of an input byte, 6000h, or of a watched object. A TPDO before the answer is newer."""
        self._brought = 0

    def set_input(self, sub: int, value: int) -> None:
        """Sets one input byte as requested at `begin_input_read`, without the bits of newer TPDOs."""
        self._answer(8 * (sub - 1), 8, value)

    def receive_frame(self, cob_id: int, data: bytes, now: float) -> bool:
        """Takes a frame from the board; returns whether it was understood. Call `runner.check` afterwards."""
        function = cob_id & 0x780
        if function == cia301.HEARTBEAT:
            if len(data) != 1 or not self._receive_state(data[0], now):
                return False
        elif (tpdo := self._tpdos.get(cob_id)) is not None:
            if not self._receive_inputs(data, *tpdo):
                return False
        elif function == cia301.EMERGENCY and len(data) >= 2:
            self._receive_emergency(int.from_bytes(data[:2], "little"), data[2] if len(data) > 2 else 0)
            if len(data) > 2 and ERROR_REGISTER in self.layout.watched:
                self._bring(first_watched(self.layout.watched.index(ERROR_REGISTER)), 8, data[2])
        elif function == cia301.SDO_ANSWER and len(data) == 8:
            self.runner.receive_sdo(data, now)
        else:
            return False
        self.frames += 1
        return True

    def tick(self, now: float, timeout: float, stalled: bool) -> None:
        """Ends timeouts; detects a silence of `timeout` [s], which is the board's loss, and a second board."""
        if not self._lost and self._beat_at is not None and now - self._beat_at >= timeout:
            self._lost, self.held = True, None
            if self._ready:
                what = "no answer to node guarding" if self.guarded else "no heartbeat"
                self.fail("board-lost", f"board {self.name}: {what} for {timeout:g} s: is it powered and wired?")
        self.runner.tick(now)
        twice = self.beats.twice(now, stalled) or self.runner.answered_twice
        if twice and self._ready:
            self.fail("duplicate-node", f"two boards answer as {self.name}: give each its own node id, then reset")

    def status(self, now: float) -> BoardStatus:
        state = "unknown" if self.state is None else self.state.words
        return BoardStatus(
            bus=self.layout.bus,
            node=self.layout.node,
            state="lost" if self._lost and self.state is not None else state,
            heartbeat_age=None if self._beat_at is None else max(now - self._beat_at, 0.0),
            unverified=self.unverified,
            emergency=None if self.emergency is None else cia301.emergency_words(self.emergency),
        )

    def _receive_state(self, byte: int, now: float) -> bool:
        """Takes a heartbeat, or an answer to node guarding, in which bit 7 alternates."""
        if self.guarded:
            toggle, byte = byte >> 7, byte & 0x7F
            if byte != State.BOOT_UP:
                if toggle == self._toggle:
                    return True  # a repeated answer is no sign of life
                self._toggle = toggle
        if (state := STATES.get(byte)) is None:
            return False
        self.state = state
        self.beats.heard += 1
        self._beat_at, self._lost = now, False
        if state is not State.OPERATIONAL and not (self.held and state is State.PRE_OPERATIONAL):
            self.held = None
        if state is State.BOOT_UP:
            self.boots += 1
            self.restarted = True
            self._toggle = None
        if state is State.BOOT_UP and self._booted:  # also after a loss
            self._booted = self.released = False
            what = "it has restarted, its outputs are unknown: check its supply, then reset"
            self.fail("board-rebooted", f"board {self.name}: {what}")
        elif self._ready and state is not State.OPERATIONAL:
            seen = f"without a command and is {state.words} now"
            self.fail("board-stopped", left_operational(self.name, seen))
        return True

    def _receive_emergency(self, code: int, register: int) -> None:
        if code >> 8 == 0:
            self.emergency, self.emergency_register = None, 0
            return
        self.emergency, self.emergency_register, self.held = code, register, None
        if self._ready:  # before that, the emergency may be old: the boot reads 1001h
            self._fault("emergency", f"it reports {cia301.emergency_words(code)}: remove the cause, then reset")

    def _receive_inputs(self, data: bytes, size: int, carried: Iterable[Carried]) -> bool:
        """Takes a TPDO. If it is longer than its mapping, only the first bytes count (CiA 301, 7.5.2.36)."""
        if len(data) < size:
            if self._ready:  # during a boot it may still send its previous mapping
                what = f"its inputs came in {len(data)} bytes, not in {size}"
                self._fault("wrong-length", f"{what}: does another device send its TPDO?")
            return False
        text = f"its inputs come in {len(data)} bytes, though {size} are mapped: only the first ones are used"
        if len(data) > size and self._ready and text not in self.warnings:
            self.warnings = (*self.warnings, text)
        number = int.from_bytes(data, "little")
        for bit, place, count in carried:
            self._bring(bit, count, number >> place)
        return True

    def _bring(self, bit: int, count: int, value: int) -> None:
        """Sets bits from a frame that nobody asked for: it is newer than an answer that is still to come."""
        if bit >= FIRST_WATCHED:
            self.unread.pop(self.layout.watched[(bit - FIRST_WATCHED) // WATCHED_BITS], None)
        self._brought &= ~(((1 << count) - 1) << bit)
        self._answer(bit, count, value)
        self._brought |= ((1 << count) - 1) << bit

    def _answer(self, bit: int, count: int, value: int) -> None:
        mask = ((1 << count) - 1) << bit & ~self._brought
        self._set_inputs(self._inputs & ~mask | value << bit & mask)

    def _set_inputs(self, inputs: int) -> None:
        changed, self._inputs = inputs ^ self._inputs, inputs
        if changed:
            self._lines.levels ^= union(bit.line for bit in self.layout.inputs if changed & bit.place)

    def _ask_inputs(self) -> Procedure:
        for sub in subs_of(self.layout.input_bits):
            self.begin_input_read()
            outcome = yield Transfer(0x6000, sub, timeout=_INPUT_TIMEOUT, tries=2, fresh=True)
            if outcome.data:
                self.set_input(sub, outcome.data[0])

    def ask_watched(self) -> Procedure:
        """Reads the watched objects. Without an answer of an object, its interlocks count as open."""
        for k, it in enumerate(self.layout.watched):
            self.begin_input_read()
            outcome = yield Transfer(*it, timeout=_INPUT_TIMEOUT, tries=2, fresh=True)
            self._take(k, it, outcome)

    def _take(self, k: int, it: WatchedObject, outcome: SdoOutcome) -> None:
        if self._brought >> first_watched(k) & 1:
            return
        self.unread.pop(it, None)
        value = int.from_bytes(outcome.data or b"", "little")
        if fault := objects.unwatchable(self.name, *it, self.layout.watched_bits(k).bit_length() - 1, outcome):
            self.unread[it] = fault.message
            value = union(bit.place for bit in self.layout.inputs if bit.inverted) >> first_watched(k)  # all open
        self._answer(first_watched(k), WATCHED_BITS, value)

    def _polled(self, fault: ArmFault | None, now: float) -> None:
        self.poll_due = now + self._poll_period

    def _answered(self, fault: ArmFault | None, now: float) -> None:
        self.questioning = False
        if self._question_again:
            self.question(now)

    def _fault(self, code: str, what: str) -> None:
        self.report(ArmFault(code, self.name, f"board {self.name}: {what}"))


def _ask_presence() -> Procedure:
    yield Transfer(0x1000, 0, tries=1)
