"""What is known of one board from the frames it sends."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from drivers import cia301
from drivers.cia301 import State
from drivers.faults import Fault
from drivers.layout import Board
from drivers.status import BoardStatus

_ANSWERS = b"\x4f\x00\x60", b"\x43\x00\x60"  # to a question for a byte of 6000h, in one or four (CiA 301, 7.2.4.3.6)
_MASTER_LOST = 0x8130


class Node:
    """One board as heard on the bus.

    Attributes:
        board: what is wired to it.
        state: of its network management, None before the first heartbeat.
        frames: frames heard from it.
        inputs: (its input bytes,) view into the image of all inputs.
        input_frames: TPDOs heard from it.
    """

    def __init__(self, board: Board, inputs: NDArray[np.uint8]) -> None:
        self.board = board
        self._ready = False
        self.state: State | None = None
        self.frames = self._frames_before = 0
        self.inputs = inputs
        self.input_frames = 0
        self._beats = self._beats_seen = 0
        self._silent = 0.0
        self._lost = False
        self._emergency: str | None = None
        self._up = False  # brought up since it was forgotten last
        self._asked_at = -1  # how many TPDOs had come when it was asked

    @property
    def heard(self) -> bool:
        """Whether it says anything, if it was lost since then."""
        return self._ready or self.frames > self._frames_before

    @property
    def ready(self) -> bool:
        """Brought up and not lost since; only then are its outputs and inputs known."""
        return self._ready

    @ready.setter
    def ready(self, ready: bool) -> None:
        if not ready:
            self._frames_before = self.frames
        self._ready = ready
        self._up |= ready

    def forget(self) -> None:
        """Takes nothing as known until it is heard anew."""
        self.ready = self._up = False
        self.state = None

    def ask(self) -> tuple[int, ...]:
        """Expects answers on its inputs; returns the sub-indices of 6000h to ask for."""
        self._asked_at = self.input_frames
        return self.board.inputs

    def receive(self, function: int, data: bytes) -> tuple[bool, Fault | None]:
        """Takes a frame from the board.

        Args:
            function: code of the frame's COB-ID.
            data: 0..8 bytes.

        Returns:
            Whether the frame meant something, and what was wrong.
        """
        fault = None
        if function == cia301.HEARTBEAT and len(data) == 1 and (state := State.of(data[0])) is not None:
            fault = self._receive_state(state)
        elif function == cia301.EMERGENCY and len(data) >= 2:
            fault = self._receive_emergency(int.from_bytes(data[:2], "little"))
        elif function == cia301.TPDO1 and self.inputs.size:
            if len(data) != self.inputs.size:
                return False, self._refuse_inputs(len(data))
            self.inputs[:] = np.frombuffer(data, np.uint8)
            self.input_frames += 1
        elif function == cia301.SDO_ANSWER and data[:3] in _ANSWERS and data[3] in self.board.inputs:
            if self.input_frames == self._asked_at:  # else a newer word came by TPDO
                self.inputs[self.board.inputs.index(data[3])] = data[4]
        elif function != cia301.SDO_ANSWER:
            return False, None
        self.frames += 1
        return True, fault

    def tick(self, elapsed: float, timeout: float) -> Fault | None:
        """Counts how long the board has been silent.

        Args:
            elapsed: since the last call [s].
            timeout: silence after which it is lost [s].
        """
        beats = self._beats
        if beats != self._beats_seen:
            self._beats_seen, self._silent, self._lost = beats, 0.0, False
            return None
        # A control loop that stalled finds its boards' heartbeats not yet read: one late call alone must not lose them.
        self._silent += min(elapsed, timeout / 2)
        self._lost = self._lost or self._silent >= timeout
        if not self._lost or not self.ready:
            return None
        self.ready = False
        return self._fault("board-lost", f"no heartbeat for {timeout:g} s: is it powered and wired?")

    def status(self) -> BoardStatus:
        """For diagnostics."""
        state = "unknown" if self.state is None else self.state.words
        return BoardStatus(
            bus=self.board.bus,
            node=self.board.node,
            state="lost" if self._lost and self.state is not None else state,
            heartbeat_age=self._silent if self._beats else None,
            emergency=self._emergency,
        )

    def _receive_state(self, state: State) -> Fault | None:
        self.state = state
        self._beats += 1
        if state is State.BOOT_UP and self._up:  # also of a board that was lost before
            self.ready = self._up = False
            return self._fault("board-rebooted", "it started anew, its outputs are off: check its supply, then reset")
        if not self.ready or state is State.OPERATIONAL:
            return None
        self.ready = False
        return self._fault("board-stopped", f"it left operational by itself and is {state.words} now")

    def _receive_emergency(self, code: int) -> Fault | None:
        if code >> 8 == 0:
            self._emergency = None
            return None
        self._emergency = cia301.emergency_words(code)
        if code == _MASTER_LOST and not self.ready:  # so are we, and it was told why
            return None
        return self._fault("emergency", f"it reports {self._emergency}")

    def _refuse_inputs(self, given: int) -> Fault | None:
        """While it starts, a board may still send what it was made to send; later it must not."""
        if not self.ready:
            return None
        what = f"its inputs came in {given} bytes, not in {self.inputs.size}: does another device send its TPDO?"
        return self._fault("wrong-length", what)

    def _fault(self, code: str, what: str) -> Fault:
        return Fault(code, self.board.name, f"board {self.board.name}: {what}")
