"""Rules for the frames of an executor: heartbeats, boot of boards, and switches of accepted programs only."""

from __future__ import annotations

from collections.abc import Callable

from hyperbit.controller.executor.core.core import Executor
from hyperbit.controller.program import (
    Accepted,
    Down,
    Ended,
    Program,
    Replaced,
    Replacement,
    Setpoint,
    Stage,
    Up,
    unpack,
)
from hyperbit.drivers.canopen.wire import cia301
from hyperbit.drivers.canopen.wire.cia301 import Frame
from hyperbit.drivers.canopen.wiring import MASTER, Wiring

STREAM = -1  # in place of a program's number


class Moved(AssertionError):
    """A frame was sent, or an output switched, without an accepted program."""


class Wedged(AssertionError):
    """A reset did not make the arm ready, although all faults were removed."""


class Flood(AssertionError):
    """The log grew with the number of frames."""


class Judge:
    """Checks that the executor commands only the states of programs and set-points."""

    def __init__(self, wiring: Wiring) -> None:
        self._wiring = wiring
        self._rpdos = {cia301.RPDO1 + channel.node for channel in wiring.channels}
        self.asked: dict[int, set[int]] = {}
        self.syncs = 0
        self._proposed: dict[int, list[Program | Replacement]] = {}
        self._ended: set[int] = set()
        self._latched: dict[int, bytes] = {}
        self._staged: dict[int, int] = {}  # sub-index of the last write of 6200h in two steps, by its COB-ID

    def begin(self) -> None:
        for number in self._ended:
            self.asked.pop(number, None)
        self._ended.clear()

    def end(self, executing: bool) -> None:
        """Removes set-points that are not followed after this event."""
        if not executing:
            self.asked.pop(STREAM, None)

    def clear(self) -> None:
        self.asked.clear()
        self._proposed.clear()
        self._latched.clear()

    def proposed(self, message: Down) -> None:
        match message:
            case Program():
                self._proposed[message.program] = [message]
            case Replacement():
                self._proposed.setdefault(message.program, []).append(message)
            case Setpoint():
                self.asked.setdefault(STREAM, set()).update(unpack(states) for states in message.stages)
            case _:
                pass

    def heard(self, message: Up) -> None:
        match message:
            case Accepted():
                self.asked[message.program] = self._states(message.program)
            case Replaced(accepted=True):
                self.asked[message.program] |= self._states(message.program)
            case Ended():
                self._ended.add(message.program)
            case _:
                pass

    def judge(self, frame: Frame, core: Executor, pins: Callable[[int], int]) -> None:
        """Checks a frame of the executor.

        Args:
            pins: returns the pins of a board that are on, by its node id.

        Raises:
            Moved: the executor may not send this frame now.
        """
        cob_id, data = frame
        if cob_id == cia301.HEARTBEAT + MASTER:
            return
        if cob_id in self._rpdos and self.asked:
            self._latched[cob_id] = data
            return
        if cob_id == cia301.SYNC and self.asked:
            self.syncs += 1
            self._judge_states(self._sent(core.master.outputs.commanded), ~core.locked.mask)
            return
        sdo = cob_id & 0x780 == cia301.SDO_REQUEST
        if sdo and data[0] in (0x40, 0x80):  # to read, and to abort
            return
        if core.master.booting.under_way and (cob_id == cia301.NMT or sdo):
            value = 0
            if sdo and data[0] & 0xE0 == 0:  # the second step of a write
                value = data[1] << 8 * (self._staged[cob_id] - 1)
            elif sdo and data[1:3] == b"\x00\x62" and data[0] & 0x02:
                value = data[4] << 8 * (data[3] - 1)
            elif sdo and data[1:3] == b"\x00\x62":
                self._staged[cob_id] = data[3]
            if value and value & ~pins(cob_id & 0x7F):  # the boot may write outputs off
                raise Moved("outputs were switched on by SDO")
            return
        raise Moved(f"{cob_id:03X}h {data.hex()} was sent in mode {core.modes.mode} without a goal that asks for it")

    def _judge_states(self, sent: int, free: int) -> None:
        asked = set[int]().union(*self.asked.values())
        if sent & free not in {states & free for states in asked}:
            raise Moved(f"{sent:06b} was switched, {[f'{states:06b}' for states in asked]} are asked for")

    def _sent(self, outputs: int) -> int:
        """Returns the states in the last frames; for boards without frames, the states that the master has read."""
        for cob_id, data in self._latched.items():
            for k, channel in enumerate(self._wiring.channels):
                if cia301.RPDO1 + channel.node == cob_id:
                    outputs = outputs & ~(1 << k) | (data[0] >> channel.output & 1) << k
        return outputs

    def _states(self, program: int) -> set[int]:
        stages: list[Stage] = [stage for message in self._proposed[program] for stage in message.stages]
        return {unpack(stage.states) for stage in stages}
