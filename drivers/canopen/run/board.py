"""One board: NMT state, heartbeats or node guarding, emergencies and inputs, as received from the bus."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field

from hyperbit.drivers.canopen.faults import ArmFault
from hyperbit.drivers.canopen.layout import BoardLayout
from hyperbit.drivers.canopen.pdo import INPUTS, Carried, Pdo, carries, subs_of, union
from hyperbit.drivers.canopen.sdo.client import Transfer
from hyperbit.drivers.canopen.sdo.objects import Need
from hyperbit.drivers.canopen.sdo.procedure import Procedure, Runner
from hyperbit.drivers.canopen.status import BoardStatus
from hyperbit.drivers.canopen.wire import cia301
from hyperbit.drivers.canopen.wire.cia301 import STATES, Command, State
from hyperbit.drivers.canopen.wire.link import Link

_INPUT_TIMEOUT = 0.3  # [s] for the inputs
_WINDOW = 10  # periods of the heartbeat in which it is counted


@dataclass
class StateImage:
    """Levels of all input lines. Each board writes its own lines.

    Attributes:
        ends: levels of the input lines.
        up: mask of the input lines whose board is ready.
        known: mask of the actuators whose boards are all ready: that of the outputs and those of the end-stops.
    """

    ends: int = 0
    up: int = 0
    known: int = 0
    _missing: dict[str, int] = field(default_factory=dict)  # actuators of each board that is not ready

    def set_ready(self, board: BoardLayout, ready: bool) -> None:
        """Records whether a board is ready."""
        if ready:
            self._missing.pop(board.name, None)
            self.up |= board.input_lines
            self.known |= board.actuators & ~union(self._missing.values())
        else:
            self._missing[board.name] = board.actuators
            self.up &= ~board.input_lines
            self.known &= ~board.actuators


class BeatCount:
    """Counts the heartbeats of one node id: two boards send twice as many.

    Attributes:
        period: configured period of the heartbeat [s]; 0 if unknown, or with node guarding.
    """

    def __init__(self) -> None:
        self.period = 0.0
        self._heard = self._windows = 0
        self._began: float | None = None

    def heard(self) -> None:
        """Counts a heartbeat."""
        self._heard += 1

    def twice(self, now: float, stalled: bool) -> bool:
        """Returns whether two successive windows of 10 periods had 15 heartbeats or more. Call at each tick.

        Frames that were held up come at once, but after a window with few of them.
        """
        if not self.period or stalled or self._began is None:
            self._began, self._heard, self._windows = now, 0, 0
        elif now - self._began >= _WINDOW * self.period:
            self._windows = self._windows + 1 if self._heard >= 1.5 * _WINDOW else 0
            self._began, self._heard = now, 0
        return self._windows >= 2


class Board:
    """One board.

    Attributes:
        layout: wiring of the board.
        state: NMT state; None if unknown.
        frames: number of frames received from the board.
        boots: number of boot-up messages received from it.
        restarted: whether it has restarted since its last boot, so that its outputs are off or unknown.
        input_frames: number of TPDOs received from it.
        emergency: error code of its last emergency; None without an emergency, or after its end.
        guarded: whether node guarding supervises the board, in place of heartbeats.
        emergency_register: error register, 1001h, in that emergency; 0 without one.
        unverified: number of switches and reads whose outputs could not be read back.
        history: newest error, 1003h sub 1, at the end of the last boot; None if it is not there.
        ignored_errors: bits of the error register 1001h that are no fault.
        warnings: sentences on the board's limits from its last boot, without its name.
        expected: values of its objects at the end of the last boot.
        beats: counts its heartbeats.
        released: whether outputs were written off before the last start.
        held: whether an NMT command 80h of another program, and nothing else, has made it leave operational, so that
            its pins hold; None: something else may have changed them.

    Args:
        layout: wiring of the board.
        image: takes the inputs of the board.
        report: takes faults.
    """

    def __init__(self, layout: BoardLayout, image: StateImage, report: Callable[[ArmFault], None]) -> None:
        self.layout = layout
        self.state: State | None = None
        self.frames = self.boots = self.input_frames = 0
        self._image, self.report = image, report
        self._inputs = 0
        self._ready = self._booted = self._lost = self.restarted = False
        self._frames_before = 0  # number of frames when the board was lost
        self._beat_at: float | None = None
        self.emergency: int | None = None
        self.guarded = False
        self.ignored_errors = self.emergency_register = self.unverified = 0
        self.history: int | None = None
        self.warnings: tuple[str, ...] = ()
        self.expected: tuple[Need, ...] = ()
        self.beats = BeatCount()
        self.released = False
        self.held: bool | None = None
        self._toggle: int | None = None  # toggle bit of the last answer to node guarding
        self._tpdos: dict[int, tuple[int, list[Carried]]] = {}
        self.set_tpdos(layout.tpdos)
        image.set_ready(layout, False)
        image.ends |= sum(bit.line for bit in layout.inputs if bit.inverted)

    @property
    def name(self) -> str:
        """Name for messages, e.g. "can0/5"."""
        return self.layout.name

    @property
    def heard(self) -> bool:
        """Whether the board is ready, or has sent a frame since it was lost."""
        return self._ready or self.frames > self._frames_before

    @property
    def ready(self) -> bool:
        """Whether the board was booted and not lost since. Only then its outputs and inputs are known."""
        return self._ready

    @ready.setter
    def ready(self, ready: bool) -> None:
        self._ready = ready
        if ready:
            self._booted, self.restarted, self.held = True, False, False
        else:
            self._frames_before = self.frames
        self._image.set_ready(self.layout, ready)

    def forget(self) -> None:
        """Marks outputs, inputs and NMT state as unknown until the next boot."""
        self.released &= not self._booted  # an attempt that failed is not the last start
        self.ready = self._booted = False
        self.state = self.history = None

    def fail(self, fault: ArmFault) -> None:
        """Marks outputs and inputs as unknown until the next boot, and reports a fault."""
        self.ready = False
        self.report(fault)

    @property
    def stopped(self) -> bool:
        """Whether it is heard, and is stopped: it answers no SDO."""
        return self.state is State.STOPPED and not self._lost

    def obey(self, command: int) -> None:
        """Takes an NMT command of another program for the board."""
        self.held = True if command == Command.PRE_OPERATIONAL and self.held is not None else None
        if not self._ready:
            self.state = None

    def guard(self) -> None:
        """Expects answers to node guarding from now on."""
        self.guarded, self._toggle = True, None

    def set_tpdos(self, tpdos: Iterable[Pdo]) -> None:
        """Sets the TPDOs that carry the inputs."""
        self._tpdos = {pdo.cob_id: (pdo.size, carries(pdo.mapping, INPUTS)) for pdo in tpdos}

    def set_input(self, sub: int, value: int) -> None:
        """Sets one byte of the inputs, 6000h, that was read by SDO."""
        shift = 8 * (sub - 1)
        self._set_inputs(self._inputs & ~(0xFF << shift) | (value & 0xFF) << shift)

    def receive_frame(self, cob_id: int, data: bytes, now: float) -> bool:
        """Takes a frame from the board.

        Args:
            cob_id: COB-ID of the frame.
            data: 0..8 bytes.
            now: time that stands still while the loop stalls [s].

        Returns:
            Whether the frame was understood.
        """
        function = cob_id & 0x780
        if function == cia301.HEARTBEAT:
            if len(data) != 1 or not self._receive_state(data[0], now):
                return False
        elif (tpdo := self._tpdos.get(cob_id)) is not None:
            size, carried = tpdo
            if len(data) < size:
                self._refuse_inputs(len(data), size)
                return False
            if len(data) > size:
                self._warn_of_padding(len(data), size)
            self.input_frames += 1
            number, inputs = int.from_bytes(data, "little"), self._inputs
            for bit, place, count in carried:
                mask = (1 << count) - 1
                inputs = inputs & ~(mask << bit) | (number >> place & mask) << bit
            self._set_inputs(inputs)
        elif function == cia301.EMERGENCY and len(data) >= 2:
            self._receive_emergency(int.from_bytes(data[:2], "little"), data[2] if len(data) > 2 else 0)
        elif function != cia301.SDO_ANSWER or len(data) != 8:
            return False
        self.frames += 1
        return True

    def tick(self, now: float, timeout: float) -> None:
        """Reports the board as lost after a silence of `timeout` [s]."""
        if self._lost or self._beat_at is None or now - self._beat_at < timeout:
            return
        self._lost, self.held = True, None
        if self._ready:
            self.ready = False
            missing = "no answer to node guarding" if self.guarded else "no heartbeat"
            self._fault("board-lost", f"{missing} for {timeout:g} s: is it powered and wired?")

    def status(self, now: float) -> BoardStatus:
        """Returns the status for diagnostics."""
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
        self.beats.heard()
        self._beat_at, self._lost = now, False
        if state is not State.OPERATIONAL and not (self.held and state is State.PRE_OPERATIONAL):
            self.held = None
        if state is State.BOOT_UP:
            self.boots += 1
            self.restarted = True
            self._toggle = None
        if state is State.BOOT_UP and self._booted:  # also if it was lost before that
            self.ready = self._booted = self.released = False
            self._fault("board-rebooted", "it has restarted, its outputs are unknown: check its supply, then reset")
        elif self._ready and state is not State.OPERATIONAL:
            self.ready = False
            what = f"it left the state operational without a command and is {state.words} now"
            self._fault("board-stopped", f"{what}: read its errors, then reset")
        return True

    def _receive_emergency(self, code: int, register: int) -> None:
        if code >> 8 == 0:
            self.emergency, self.emergency_register = None, 0
            return
        self.emergency, self.emergency_register, self.held = code, register, None
        if self._ready:  # before, it may be old: the boot reads 1001h
            self._fault("emergency", f"it reports {cia301.emergency_words(code)}: remove the cause, then reset")

    def _set_inputs(self, inputs: int) -> None:
        changed = inputs ^ self._inputs
        if not changed:
            return
        self._inputs = inputs
        ends = self._image.ends
        for line, place, _ in self.layout.inputs:
            if changed & place:
                ends ^= line
        self._image.ends = ends

    def _refuse_inputs(self, size: int, expected: int) -> None:
        if self._ready:  # during a boot it may still send its previous mapping
            what = f"its inputs came in {size} bytes, not in {expected}"
            self._fault("wrong-length", f"{what}: does another device send its TPDO?")

    def _warn_of_padding(self, size: int, mapped: int) -> None:
        """Warns once of a TPDO that is longer than its mapping; its first bytes count (CiA 301, 7.5.2.36)."""
        text = f"its inputs come in {size} bytes, though {mapped} are mapped: only the first ones are used"
        if self._ready and text not in self.warnings:
            self.warnings = (*self.warnings, text)

    def _fault(self, code: str, what: str) -> None:
        self.report(ArmFault(code, self.name, f"board {self.name}: {what}"))


class Station:
    """One board on its bus.

    Attributes:
        index: index of the board.
        board: the state of the board.
        runner: runs procedures with it.
        questioning: whether a question for its inputs waits for the answer.
    """

    def __init__(self, index: int, board: Board, link: Link) -> None:
        self.index, self.board = index, board
        self.runner = Runner(board.layout.node, link)
        self.questioning = False
        self._again = False

    def cancel(self) -> None:
        """Cancels the running procedure."""
        self.runner.cancel()
        self.questioning = self._again = False

    def question(self, now: float) -> None:
        """Asks for the inputs; asks again after a running question, whose answer may be too old."""
        if self.questioning:
            self._again = True
        elif self.board.ready and self.board.layout.inputs:
            self.questioning, self._again = True, False
            self.runner.start(_ask_inputs(self.board), self._answered, now)

    def probe(self, now: float) -> None:
        """Asks for the device type, 1000h; any answer shows that the board is back."""
        if not self.runner.running:
            self.runner.start(_ask_presence(), None, now)

    def _answered(self, fault: ArmFault | None, now: float) -> None:
        self.questioning = False
        if self._again:
            self.question(now)


def _ask_inputs(board: Board) -> Procedure:
    before = board.input_frames
    for sub in subs_of(board.layout.input_bits):
        outcome = yield Transfer(0x6000, sub, timeout=_INPUT_TIMEOUT, tries=2, fresh=True)
        if outcome.data and board.input_frames == before:  # otherwise a TPDO has brought newer values
            board.set_input(sub, outcome.data[0])


def _ask_presence() -> Procedure:
    yield Transfer(0x1000, 0, tries=1)
