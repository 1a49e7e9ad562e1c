"""CAN frames, decoded from a byte string, sent to the executor and its boards in all states."""

from __future__ import annotations

import logging
import struct

import can
from hypothesis import strategies as st

from hyperbit.controller.program import Cancel, Reset, Stop
from hyperbit.drivers.canopen.wire.cia301 import Frame
from hyperbit.drivers.simulation.actuator import Actuator
from hyperbit.drivers.simulation.firmware import SimulatedBoard, Wired
from tests.fuzz.judge import Flood, Moved
from tests.fuzz.world import COMMANDS, NODES, World

SIZE = 12  # bytes of one act: kind, identifier, length, data
BASES = (0x080, 0x180, 0x200, 0x280, 0x300, 0x580, 0x600, 0x700)
IDS = [*(base + node for node in NODES for base in BASES), 0x000, 0x080, 0x77F, 0x100, 0x7E4, 0x7FF]
OBJECTS = (0, 0x1000, 0x6200, 0x6000, 0x1800, 0x1017, 0x1400, 0x1A00)  # that the driver asks for
LENGTHS = (0, 1, 2, 3, 8, 12, 16, 20, 24, 32, 48, 64)  # of FD frames
ERRORS = (0x004, 0x040, 0x100, 0x020, 0x204)
LINES = 40  # most lines of the log between two boots of the boards: one a source and code, and the modes


def message(kind: int, number: int, length: int, data: bytes) -> can.Message:
    cob_id = IDS[number % len(IDS)] if kind & 1 else number & 0x7FF
    match kind >> 1 & 15:
        case 0:
            wide = cob_id if kind & 1 else number * 8191 & 0x1FFFFFFF
            return can.Message(arbitration_id=wide, data=data[:length], is_extended_id=True)
        case 1:
            return can.Message(arbitration_id=cob_id, dlc=length, is_remote_frame=True, is_extended_id=False)
        case 2:
            kinds = ERRORS[number % len(ERRORS)] if kind & 1 else number * 8191 & 0x1FFFFFFF
            return can.Message(arbitration_id=kinds, data=data[:length], is_error_frame=True)
        case 3:
            many = (data * 8)[: LENGTHS[number % len(LENGTHS)]]
            return can.Message(arbitration_id=cob_id, data=many, is_fd=True, is_extended_id=bool(kind & 1))
        case _:
            return can.Message(arbitration_id=cob_id, data=data[:length], is_extended_id=False)


def acts(data: bytes) -> list[tuple[int, int, int, bytes]]:
    cut = [data[k : k + SIZE] for k in range(0, len(data) - SIZE + 1, SIZE)]
    return [(a[0], a[1] | a[2] << 8, a[3] % 9, a[4:]) for a in cut]


class Boards:
    """The executor's core with master and boards, reused for all inputs; each input ends with a ready arm."""

    def __init__(self) -> None:
        self.world = World()
        self.syncs = 0

    def __call__(self, data: bytes) -> int:
        world, frames = self.world, 0
        world.lines, before, boots = 0, world.judge.syncs, world.boots
        for kind, number, length, body in acts(data):
            match kind:
                case 0xF0 | 0xF1 | 0xF2 | 0xF3:
                    world.go(1 + min(number % 12, number >> 8 & 15))
                case 0xF4 | 0xF5:
                    world.program(*(body[k] & 0x3F for k in range(1 + length % 4)))
                    world.go(1)
                case 0xF6:
                    world.send(Stop(1) if number % 2 else Cancel(1, None, "canceled"))
                    world.go(1)
                case 0xF7 | 0xF8:
                    world.send(Reset(1, world.epoch))
                    world.go(2)
                case 0xF9 | 0xFA | 0xFB | 0xFC:
                    frames += 1
                    world.arm_ambush(number & 3, OBJECTS[(number >> 2) % len(OBJECTS)], body)
                case 0xFD:
                    world.supply(NODES[number % 2], on=False)
                case 0xFE:
                    world.supply(NODES[number % 2], on=True)
                case _:
                    frames += 1
                    world.attack(message(kind, number, length, body))
                    if kind & 0x60 == 0x60:
                        world.go(1)
        world.check_outputs()
        world.recover()
        self.syncs += world.judge.syncs - before
        if world.lines > LINES * (world.boots - boots + 2):
            raise Flood(f"{world.lines} lines of {frames} frames, the last: {world.last}")
        return frames


class Lines(logging.Handler):
    def __init__(self) -> None:
        super().__init__(logging.INFO)
        self.count, self.last, self.traceback = 0, "", ""

    def emit(self, record: logging.LogRecord) -> None:
        self.count += 1
        if record.exc_info:
            self.traceback = logging.Formatter().formatException(record.exc_info)
        self.last = record.getMessage()


class Firmware:
    """A simulated board, alone on its bus, reused for all inputs; each input begins with a restarted board."""

    def __init__(self) -> None:
        self.actuators = [Actuator("a", 0.02), Actuator("b", 0.02)]
        wired = [Wired(self.actuators[0], 0, 0), Wired(self.actuators[1], 9, 9)]
        self.board = SimulatedBoard(NODES[0], wired, lambda cob_id, data: self.heard.append(Frame(cob_id, data)))
        self.heard: list[Frame] = []
        self.now = 0.0
        self.log = Lines()
        logging.getLogger().addHandler(self.log)
        logging.getLogger().setLevel(logging.INFO)

    def __call__(self, data: bytes) -> int:
        board, frames, commanded = self.board, 0, False
        self.log.count = 0
        self.now += 1.0
        board.power_cut(self.now)
        board.power_on(self.now)
        before = self._switches()
        if len(data) % 2:
            board.receive(0, bytes([1, board.node]), self.now)
        for kind, number, length, body in acts(data):
            self.now += 0.05 if kind & 0x20 else 0.001
            it = message(kind | 0x1E, number, length, body)
            board.receive(it.arbitration_id, bytes(it.data), self.now)
            commanded |= it.arbitration_id in COMMANDS
            frames += 1
            if kind & 0x40:
                board.step(self.now)
            if len(self.heard) > 8:
                raise Flood(f"{len(self.heard)} answers to one frame")
            self.heard.clear()
        board.step(self.now + 1000.0)
        self.heard.clear()
        if not commanded and self._switches() != before:
            raise Moved("outputs were switched by frames that no board listens to")
        if self.log.count:
            raise Flood(f"{self.log.count} lines of {frames} frames, the last: {self.log.last}")
        return frames

    def _switches(self) -> list[int]:
        return [actuator.switches for actuator in self.actuators]


def act(kind: int, number: int = 0, length: int = 8, body: bytes = b"") -> bytes:
    return struct.pack("<BHB8s", kind, number, length, body)


STANDARD, KNOWN = 0x48, 0x49  # a frame with any identifier, and with one that means something
STARTS = [
    b"\x2f\x00\x62\x01\xff",
    b"\x40\x00\x10",
    b"\x23\x00\x14\x01\x05\x02\0\x80",
    b"\x60",
    b"\x21\x17\x10",
    b"\x01",
]
SEEDS = [
    b"".join(act(KNOWN, number, length, b"\x05") for number in range(len(IDS)) for length in (0, 1, 2, 8)),
    act(0xF4, 0, 3, b"\1\2\3\4\5\6") + act(0xF0, 4) + act(KNOWN, 1, 1, b"\x07") + act(0xF7) + act(0xF0, 8),
    *(
        act(0xF6, 1) + act(0xF9, number, 8, first + b"\0\x10\0\x91\1\3\0") + act(0xF7) + act(0xF0, 0x0108)
        for number in range(4 * len(OBJECTS))
        for first in (b"\x43", b"\x41", b"\x80")
    ),
    *(act(KNOWN, number, length, b"\x05\x06") for number in range(len(IDS)) for length in (0, 2, 8)),
    *(act(kind, number, 1, b"\x07") for kind in range(8) for number in range(16)),
    act(0xFD, 0) + act(0xF0, 0x0F0B) * 12 + act(0xFE, 0) + act(0xF0, 0x0F0B) * 12,
    act(0xFD, 0) + act(0xF0, 11) + act(0xFE, 0) + act(0xF7) + act(0xF0, 11),
    b"".join(act(KNOWN, 6, 8, start) for start in STARTS),
    b"".join(act(4, number, 8, bytes(8)) + act(5, number, 8, b"\0\x08\0\0\0\0\x80\x80") for number in range(8)),
]
kinds = st.sampled_from([STANDARD, KNOWN, KNOWN, KNOWN | 0x20, 0xF0, 0xF4, 0xF7, 0xF9]) | st.integers(0, 255)
bodies = st.sampled_from(STARTS) | st.binary(max_size=8)
any_acts = st.lists(st.builds(act, kinds, st.integers(0, 0xFFFF), st.integers(0, 8), bodies), max_size=60).map(b"".join)
