"""One board as heard on its bus: network state, heartbeats, emergencies and inputs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from drivers.canopen import cia301
from drivers.canopen.cia301 import STATES, State
from drivers.canopen.faults import Fault
from drivers.canopen.layout import BoardLayout
from drivers.canopen.status import BoardStatus

_MASTER_LOST = 0x8130  # emergency: heartbeat of the master lost


@dataclass
class StateImage:
    """States of all actuators; boards write into it.

    Attributes:
        ends: states from the end-stops; 0 for actuators without one.
        known: mask of the actuators whose board is up.
    """

    ends: int = 0
    known: int = 0


class Board:
    """One board.

    Attributes:
        layout: its wiring.
        state: of its network management; None if unknown.
        frames: frames received from it.
        boots: boot-up messages received from it.
        input_frames: TPDOs received from it.

    Args:
        layout: its wiring.
        image: takes its inputs, and whether they are known.
        report: takes faults.
    """

    def __init__(self, layout: BoardLayout, image: StateImage, report: Callable[[Fault], None]) -> None:
        self.layout = layout
        self.state: State | None = None
        self.frames = self.boots = self.input_frames = 0
        self._image, self._report = image, report
        self._inputs = 0
        self._ready = self._booted = self._lost = False
        self._frames_before = 0  # when it was not ready for the first time
        self._beat_at: float | None = None
        self._emergency: int | None = None

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
        else:
            self._frames_before = self.frames
            self._image.known &= ~self.layout.actuators

    def forget(self) -> None:
        """Takes its states as unknown until it is booted."""
        self.ready = self._booted = False
        self.state = None

    def set_input(self, sub: int, value: int) -> None:
        """Takes one byte of 6000h that was read by SDO."""
        shift = 8 * self.layout.inputs.index(sub)
        self._take_inputs(self._inputs & ~(0xFF << shift) | (value & 0xFF) << shift)

    def receive(self, function: int, data: bytes, now: float) -> bool:
        """Takes a frame from the board.

        Args:
            function: code of the frame's COB-ID.
            data: 0..8 bytes.
            now: time that stands still while the loop stalls [s].

        Returns:
            Whether the frame had a meaning.
        """
        if function == cia301.HEARTBEAT:
            if len(data) != 1 or (state := STATES.get(data[0])) is None:
                return False
            self._receive_state(state, now)
        elif function == cia301.TPDO1 and self.layout.inputs:
            if len(data) != len(self.layout.inputs):
                self._refuse_inputs(len(data))
                return False
            self.input_frames += 1
            self._take_inputs(int.from_bytes(data, "little"))
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
            self._fault("board-lost", f"no heartbeat for {timeout:g} s: is it powered and wired?")

    def status(self, now: float) -> BoardStatus:
        """For diagnostics."""
        state = "unknown" if self.state is None else self.state.words
        return BoardStatus(
            bus=self.layout.bus,
            node=self.layout.node,
            state="lost" if self._lost and self.state is not None else state,
            heartbeat_age=None if self._beat_at is None else now - self._beat_at,
            emergency=None if self._emergency is None else cia301.emergency_words(self._emergency),
        )

    def _receive_state(self, state: State, now: float) -> None:
        self.state = state
        self._beat_at, self._lost = now, False
        if state is State.BOOT_UP:
            self.boots += 1
        if state is State.BOOT_UP and self._booted:  # also if it was lost before
            self.ready = self._booted = False
            self._fault("board-rebooted", "it started anew, its outputs may be off: check its supply, then reset")
        elif self._ready and state is not State.OPERATIONAL:
            self.ready = False
            self._fault("board-stopped", f"it left operational by itself and is {state.words} now")

    def _receive_emergency(self, code: int) -> None:
        if code >> 8 == 0:
            self._emergency = None
            return
        self._emergency = code
        if code != _MASTER_LOST or self._ready:  # of a lost master, the cause was reported
            self._fault("emergency", f"it reports {cia301.emergency_words(code)}")

    def _take_inputs(self, inputs: int) -> None:
        changed = inputs ^ self._inputs
        if not changed:
            return
        self._inputs = inputs
        ends = self._image.ends
        for actuator, place in self.layout.ends:
            if changed & place:
                ends ^= actuator
        self._image.ends = ends

    def _refuse_inputs(self, size: int) -> None:
        if self._ready:  # while it boots, it may still send what it was configured for before
            what = f"its inputs came in {size} bytes, not in {len(self.layout.inputs)}"
            self._fault("wrong-length", f"{what}: does another device send its TPDO?")

    def _fault(self, code: str, what: str) -> None:
        self._report(Fault(code, self.name, f"board {self.name}: {what}"))
