"""What an intruder on the bus, and clients of the socket, may do to an executor and to a board."""

from __future__ import annotations

import logging
from itertools import chain
from typing import Any

import can
import msgspec
from hypothesis import strategies as st

from hyperbit.controller.program import (
    VERSION,
    Acknowledge,
    Alive,
    Cancel,
    Clearance,
    Counts,
    Down,
    Hello,
    Lock,
    Malformed,
    Program,
    ReadErrors,
    Replacement,
    Reset,
    Setpoint,
    Stage,
    Stop,
    decode_down,
    encode,
    pack,
)
from hyperbit.drivers.canopen.wire.cia301 import Frame
from hyperbit.drivers.simulation.actuator import Actuator
from hyperbit.drivers.simulation.firmware import SimulatedBoard, Wired
from tests.executor.rig import SIZE
from tests.fuzz.judge import Flood, Moved
from tests.fuzz.world import COMMANDS, NODES, OPERATOR, PLANNER, World

Act = tuple[Any, ...]  # a method of Attack, and its arguments
BASES = (0x080, 0x180, 0x200, 0x280, 0x300, 0x580, 0x600, 0x700)
IDS = [*(base + node for node in NODES for base in BASES), 0x000, 0x080, 0x77F, 0x100, 0x7E4, 0x7FF]
OBJECTS = (0, 0x1000, 0x6200, 0x6000, 0x1800, 0x1017, 0x1400, 0x1A00)  # that the driver asks for
LENGTHS = (0, 1, 2, 3, 8, 12, 16, 20, 24, 32, 48, 64)  # of FD frames
STARTS = (
    b"\x2f\x00\x62\x01\xff",
    b"\x40\x00\x10",
    b"\x23\x00\x14\x01\x05\x02\0\x80",
    b"\x60",
    b"\x21\x17\x10",
    b"\x01",
)
LINES = 40  # most lines of the log between two boots of the boards: one a source and code, and the modes


def stages(*states: int, step: float = 0.04) -> tuple[Stage, ...]:
    return tuple(Stage(pack(bits, SIZE), k * step, k, k * step) for k, bits in enumerate(states))


MESSAGES: list[Down] = [
    Alive(),
    Program(1, 0, b"\0", 0.0, stages(1, 3, 7, 63), True, False, "goal"),
    Program(2, 0, b"\0", 0.0, stages(8, 24), False, True, "goal", b"context"),
    Program(3, 0, b"\0", 0.0, stages(*range(60), step=0.0), True, False, "goal"),
    Replacement(2, 1, 2, pack(24, SIZE), stages(25, 27), True),
    Replacement(2, 2, 1, pack(8, SIZE), (), True, True),
    Setpoint(4, 0, b"\0", (b"\1", b"\3"), 2000.0, False, "following"),
    Setpoint(5, 0, b"\0", (), 2000.0, True, "following"),
    *(Clearance(1, None), Clearance(0, "it touches"), Cancel(1, None, "canceled"), Cancel(2, 1, "path"), Stop(3)),
    *(Reset(4, 0), Lock(5, 2, 0), Lock(6, 2, -1), Lock(7, 63, 1), ReadErrors(8, "can0/1"), Acknowledge(1)),
    *(Counts((1, 2, 3, 4, 5, 6)), Counts(()), Hello(VERSION, "planner", "small"), Hello(99, "operator", "other")),
]


class Attack:
    """The executor with its boards, reused for all inputs; each input ends with a ready arm.

    It may switch only stages of accepted programs and set-points of the planner.
    """

    def __init__(self) -> None:
        self.world = World()
        self.switched = 0

    def __call__(self, acts: list[Act]) -> None:
        world = self.world
        world.lines, before, boots = 0, world.judge.syncs, world.boots
        for name, *arguments in acts:
            getattr(self, name)(*arguments)
        world.check_outputs()
        world.recover()
        self.switched += world.judge.syncs - before
        if world.lines > LINES * (world.boots - boots + 2):
            raise Flood(f"{world.lines} lines of {len(acts)} acts, the last: {world.last}")

    def frame(self, message: can.Message) -> None:
        self.world.attack(message)

    def wait(self, ticks: int) -> None:
        self.world.go(ticks)

    def ambush(self, mode: int, index: int, data: bytes) -> None:
        self.world.arm_ambush(mode, index, data)

    def supply(self, node: int, on: bool) -> None:
        self.world.supply(node, on=on)

    def reset(self) -> None:
        self.packet(Reset(1, 0))

    def packet(self, body: Down | bytes, fitting: bool = True, operator: bool = False) -> None:
        try:
            message = decode_down(body if isinstance(body, bytes) else encode(body))
        except Malformed as error:
            assert str(error)  # noqa: PT017 - no test
            return
        self.world.send(self._fitted(message) if fitting else message, OPERATOR if operator else PLANNER)
        self.world.go(1)

    def _fitted(self, message: Down) -> Down:
        """Returns a message with the numbers that the executor expects."""
        core, world = self.world.core, self.world
        start, epoch, greatest = pack(world.master.outputs.commanded, SIZE), core.modes.epoch, core.requests.greatest
        match message:
            case Program():
                return msgspec.structs.replace(message, program=greatest + 1, epoch=epoch, start=start, begin=0.0)
            case Setpoint():
                until = world.now + 0.3
                return msgspec.structs.replace(message, stream=greatest + 1, epoch=epoch, start=start, until=until)
            case Reset():
                return msgspec.structs.replace(message, epoch=epoch)
            case Replacement():
                return msgspec.structs.replace(message, program=greatest)
            case Hello():
                return Hello(VERSION, message.role, world.arm.name)
            case _:
                return message


class Firmware(logging.Handler):
    """A simulated board, alone on its bus, reused for all inputs; each input begins with a restarted board."""

    def __init__(self) -> None:
        super().__init__(logging.INFO)
        self.actuators = [Actuator("a", 0.02), Actuator("b", 0.02)]
        wired = [Wired(self.actuators[0], 0, 0), Wired(self.actuators[1], 9, 9)]
        self.board = SimulatedBoard(NODES[0], wired, lambda cob_id, data: self.heard.append(Frame(cob_id, data)))
        self.heard: list[Frame] = []
        self.now, self._line = 0.0, ""
        logging.getLogger().addHandler(self)

    def emit(self, record: logging.LogRecord) -> None:
        self._line = record.getMessage()

    def __call__(self, frames: list[can.Message], *, started: bool) -> None:
        board, commanded = self.board, False
        self.now += 1.0
        board.power_cut(self.now)
        board.power_on(self.now)
        before = self._switches()
        if started:
            board.receive(0, bytes([1, board.node]), self.now)
        for it in frames:
            self.now += 0.01
            board.receive(it.arbitration_id, bytes(it.data), self.now)
            commanded |= it.arbitration_id in COMMANDS
            board.step(self.now)
            if len(self.heard) > 8:
                raise Flood(f"{len(self.heard)} answers to one frame")
            self.heard.clear()
        board.step(self.now + 1000.0)
        self.heard.clear()
        if not commanded and self._switches() != before:
            raise Moved("outputs were switched by frames that no board listens to")
        if self._line:
            raise Flood(f"a line of the log: {self._line}")

    def _switches(self) -> list[int]:
        return [actuator.switches for actuator in self.actuators]


ids = st.sampled_from(IDS) | st.integers(0, 0x7FF)
data = st.sampled_from(STARTS) | st.binary(max_size=8)
frames = st.builds(lambda cob_id, body: can.Message(arbitration_id=cob_id, data=body, is_extended_id=False), ids, data)
odd_frames = st.one_of(
    st.builds(lambda cob_id, body: can.Message(arbitration_id=cob_id, data=body), st.integers(0, 0x1FFFFFFF), data),
    st.builds(
        lambda cob_id, size: can.Message(arbitration_id=cob_id, dlc=size, is_remote_frame=True, is_extended_id=False),
        ids,
        st.integers(0, 8),
    ),
    st.builds(
        lambda kind, body: can.Message(arbitration_id=kind, data=body, is_error_frame=True),
        st.sampled_from((0x004, 0x040, 0x100, 0x020, 0x204)) | st.integers(0, 0x1FFFFFFF),
        data,
    ),
    st.builds(
        lambda cob_id, size: can.Message(arbitration_id=cob_id, data=bytes(size), is_fd=True, is_extended_id=False),
        ids,
        st.sampled_from(LENGTHS),
    ),
)
numbers = st.integers(0, 12) | st.integers(0, 2**62)
times = st.floats(0, 0.3) | st.floats(-1e12, 1e12)
masks = st.integers(0, 63).map(lambda bits: bytes([bits])) | st.binary(max_size=3)
staged = st.lists(st.builds(Stage, masks, times, st.integers(-1, 5), times), max_size=5).map(tuple)
texts = st.text(max_size=8)
packets = st.one_of(
    st.sampled_from(MESSAGES),
    st.builds(Program, numbers, numbers, masks, times, staged, st.booleans(), st.booleans(), texts),
    st.builds(Replacement, numbers, numbers, numbers, masks, staged, st.booleans(), st.booleans()),
    st.builds(Setpoint, numbers, numbers, masks, st.lists(masks, max_size=4).map(tuple), times, st.booleans(), texts),
    st.builds(Lock, numbers, st.integers(0, 9_999), st.integers(-1, 1)),
    st.builds(Clearance, numbers, st.none() | texts),
    st.builds(Counts, st.lists(numbers, max_size=8).map(tuple)),
    st.binary(max_size=40),
)
ambushes = st.tuples(st.just("ambush"), st.integers(0, 3), st.sampled_from(OBJECTS), data)
waits = st.tuples(st.just("wait"), st.integers(1, 12))
acts = st.one_of(
    st.tuples(st.just("frame"), frames),
    st.tuples(st.just("frame"), odd_frames),
    waits,
    st.tuples(st.just("packet"), packets, st.booleans(), st.booleans()),
    st.just(("reset",)),
    ambushes,
    st.tuples(st.just("supply"), st.sampled_from(NODES), st.booleans()),
)
ambushed_boots = st.builds(
    lambda ambush, ticks: [("packet", Stop(1)), ambush, ("reset",), ("wait", ticks)], ambushes, st.integers(2, 9)
)
lives = st.lists(st.one_of(acts.map(lambda act: [act]), ambushed_boots), max_size=30).map(
    lambda parts: list(chain(*parts))
)
# What once did harm: answers of a board with four bytes, and inputs of two.
FOUND: list[list[Act]] = [
    *(
        [
            ("packet", Stop(1)),
            ("ambush", 1, index, b"\x43\0\0\0\x91\1\3\0"),
            ("reset",),
            ("wait", 9),
        ]
        for index in (0x6200, 0x6000)
    ),
    [("frame", can.Message(arbitration_id=0x180 + NODES[0], data=b"\7\7", is_extended_id=False))],
]
