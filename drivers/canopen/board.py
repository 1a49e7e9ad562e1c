"""One board as heard on its bus: network state, heartbeats, emergencies and inputs."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

from drivers.canopen import cia301
from drivers.canopen.cia301 import STATES, State
from drivers.canopen.faults import Fault
from drivers.canopen.layout import BoardLayout
from drivers.canopen.objects import Need
from drivers.canopen.pdo import INPUTS, Carried, Pdo, carries
from drivers.canopen.status import BoardStatus


@dataclass
class StateImage:
    """Levels of all input lines; boards write into it.

    Attributes:
        ends: levels of the input lines.
        up: mask of the input lines whose board is up.
        known: mask of the actuators whose board is up.
    """

    ends: int = 0
    up: int = 0
    known: int = 0


class Board:
    """One board.

    Attributes:
        layout: its wiring.
        state: of its network management; None if unknown.
        frames: frames received from it.
        boots: boot-up messages received from it.
        input_frames: TPDOs received from it.
        emergency: code of its last emergency; None if there is none or it is over.
        guarded: whether it is supervised by node guarding.
        ignored_errors: bits of its error register that stand for no fault.
        warnings: what a person should know of it, as of its last boot, without its name.
        expected: what its objects hold since then.

    Args:
        layout: its wiring.
        image: takes its inputs, and whether they are known.
        report: takes faults.
    """

    def __init__(self, layout: BoardLayout, image: StateImage, report: Callable[[Fault], None]) -> None:
        self.layout = layout
        self.state: State | None = None
        self.frames = self.boots = self.input_frames = 0
        self._image, self.report = image, report
        self._inputs = 0
        self._ready = self._booted = self._lost = False
        self._frames_before = 0  # when it was not ready for the first time
        self._beat_at: float | None = None
        self.emergency: int | None = None
        self.guarded = False
        self.ignored_errors = 0
        self.warnings: tuple[str, ...] = ()
        self.expected: tuple[Need, ...] = ()
        self._toggle: int | None = None  # of the last answer to node guarding
        self._tpdos: dict[int, tuple[int, list[Carried]]] = {}
        self.take_inputs_from(layout.tpdos)
        self._lines = sum(bit.line for bit in layout.inputs)
        image.ends |= sum(bit.line for bit in layout.inputs if bit.inverted)

    @property
    def name(self) -> str:
        """For messages, e.g. "can0/5"."""
        return self.layout.name

    @property
    def heard(self) -> bool:
        """Whether it is up, or was heard since it was lost."""
        return self._ready or self.frames > self._frames_before

    @property
    def ready(self) -> bool:
        """Whether it was booted and not lost since. Only then its outputs and inputs are known."""
        return self._ready

    @ready.setter
    def ready(self, ready: bool) -> None:
        self._ready = ready
        if ready:
            self._booted = True
            self._image.known |= self.layout.actuators
            self._image.up |= self._lines
        else:
            self._frames_before = self.frames
            self._image.known &= ~self.layout.actuators
            self._image.up &= ~self._lines

    def forget(self) -> None:
        """Takes its states as unknown until it is booted."""
        self.ready = self._booted = False
        self.state = None

    def fail(self, fault: Fault) -> None:
        """Takes its states as unknown until it is booted, because of a fault."""
        self.ready = False
        self.report(fault)

    def guard(self) -> None:
        """Expects answers to node guarding from now on."""
        self.guarded, self._toggle = True, None

    def take_inputs_from(self, tpdos: Iterable[Pdo]) -> None:
        """Takes its inputs from other TPDOs."""
        self._tpdos = {pdo.cob_id: (pdo.size, carries(pdo.mapping, INPUTS)) for pdo in tpdos}

    def set_input(self, sub: int, value: int) -> None:
        """Takes one byte of 6000h that was read by SDO."""
        shift = 8 * (sub - 1)
        self._take_inputs(self._inputs & ~(0xFF << shift) | (value & 0xFF) << shift)

    def receive(self, cob_id: int, data: bytes, now: float) -> bool:
        """Takes a frame from the board.

        Args:
            cob_id: of the frame.
            data: 0..8 bytes.
            now: time that stands still while the loop stalls [s].

        Returns:
            Whether the frame had a meaning.
        """
        function = cob_id & 0x780
        if function == cia301.HEARTBEAT:
            if len(data) != 1 or not self._receive_state(data[0], now):
                return False
        elif (tpdo := self._tpdos.get(cob_id)) is not None:
            size, carried = tpdo
            if len(data) != size:
                self._refuse_inputs(len(data), size)
                return False
            self.input_frames += 1
            number, inputs = int.from_bytes(data, "little"), self._inputs
            for bit, place, count in carried:
                mask = (1 << count) - 1
                inputs = inputs & ~(mask << bit) | (number >> place & mask) << bit
            self._take_inputs(inputs)
        elif function == cia301.EMERGENCY and len(data) >= 2:
            self._receive_emergency(int.from_bytes(data[:2], "little"))
        elif function != cia301.SDO_ANSWER or len(data) != 8:
            return False
        self.frames += 1
        return True

    def tick(self, now: float, timeout: float) -> None:
        """Finds out whether the board has been silent for `timeout` [s]."""
        if self._lost or self._beat_at is None or now - self._beat_at < timeout:
            return
        self._lost = True
        if self._ready:
            self.ready = False
            missing = "no answer to node guarding" if self.guarded else "no heartbeat"
            self._fault("board-lost", f"{missing} for {timeout:g} s: is it powered and wired?")

    def status(self, now: float) -> BoardStatus:
        """For diagnostics."""
        state = "unknown" if self.state is None else self.state.words
        return BoardStatus(
            bus=self.layout.bus,
            node=self.layout.node,
            state="lost" if self._lost and self.state is not None else state,
            heartbeat_age=None if self._beat_at is None else now - self._beat_at,
            emergency=None if self.emergency is None else cia301.emergency_words(self.emergency),
        )

    def _receive_state(self, byte: int, now: float) -> bool:
        """Takes a heartbeat, or an answer to node guarding, in which bit 7 alternates."""
        if self.guarded:
            toggle, byte = byte >> 7, byte & 0x7F
            if byte != State.BOOT_UP:
                if toggle == self._toggle:
                    return True  # a repetition shows nothing
                self._toggle = toggle
        if (state := STATES.get(byte)) is None:
            return False
        self.state = state
        self._beat_at, self._lost = now, False
        if state is State.BOOT_UP:
            self.boots += 1
            self._toggle = None
        if state is State.BOOT_UP and self._booted:  # also if it was lost before
            self.ready = self._booted = False
            self._fault("board-rebooted", "it started anew, its outputs are unknown: check its supply, then reset")
        elif self._ready and state is not State.OPERATIONAL:
            self.ready = False
            self._fault("board-stopped", f"it left operational by itself and is {state.words} now")
        return True

    def _receive_emergency(self, code: int) -> None:
        if code >> 8 == 0:
            self.emergency = None
            return
        self.emergency = code
        if self._ready:  # before, it may be an old one: the boot reads the error register
            self._fault("emergency", f"it reports {cia301.emergency_words(code)}")

    def _take_inputs(self, inputs: int) -> None:
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
        if self._ready:  # while it boots, it may still send what it was configured for before
            what = f"its inputs came in {size} bytes, not in {expected}"
            self._fault("wrong-length", f"{what}: does another device send its TPDO?")

    def _fault(self, code: str, what: str) -> None:
        self.report(Fault(code, self.name, f"board {self.name}: {what}"))
