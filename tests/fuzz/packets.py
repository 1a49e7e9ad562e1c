"""Packets of clients, decoded from a byte string, sent to the executor's socket in all states."""

from __future__ import annotations

import struct

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
from tests.executor.rig import SIZE
from tests.fuzz.world import OPERATOR, PLANNER, World

HEAD = struct.Struct("<BH")  # flags, length
FITTING, WAIT, LONG, BY_OPERATOR = 1, 2, 4, 8  # flags: right numbers, a tick after it, a second after it, who sends it


class Packets:
    """The executor's core with boards and clients, reused for all inputs; each input ends with a ready arm.

    The executor may switch only stages of accepted programs and set-points of the planner.
    """

    def __init__(self) -> None:
        self.world = World()
        self.syncs = 0

    def __call__(self, data: bytes) -> int:
        world, packets, before = self.world, 0, self.world.judge.syncs
        for flags, body in packets_of(data):
            packets += 1
            try:
                message = decode_down(body)
            except Malformed as error:
                assert str(error)  # noqa: PT017 - no test
                continue
            client = OPERATOR if flags & BY_OPERATOR else PLANNER
            world.send(self._fitted(message) if flags & FITTING else message, client)
            world.go(100 if flags & LONG else flags >> 1 & 1)
        world.check_outputs()
        world.recover()
        self.syncs += world.judge.syncs - before
        return packets

    def _fitted(self, message: Down) -> Down:
        """Returns a message with the numbers that the executor expects."""
        core, world = self.world.core, self.world
        start, epoch, greatest = pack(world.master.outputs, SIZE), core.modes.epoch, core.requests.greatest
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


def packets_of(data: bytes) -> list[tuple[int, bytes]]:
    packets, at = [], 0
    while at + HEAD.size <= len(data):
        flags, length = HEAD.unpack_from(data, at)
        packets.append((flags, data[at + HEAD.size : at + HEAD.size + length]))
        at += HEAD.size + length
    return packets


def packet(flags: int, body: bytes) -> bytes:
    return HEAD.pack(flags, len(body)) + body


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
    Clearance(1, None),
    Clearance(0, "it touches"),
    Cancel(1, None, "canceled"),
    Cancel(2, 1, "path"),
    Stop(3),
    Reset(4, 0),
    Lock(5, 2, 0),
    Lock(6, 2, -1),
    Lock(7, 63, 1),
    ReadErrors(8, "can0/1"),
    Acknowledge(1),
    Counts((1, 2, 3, 4, 5, 6)),
    Counts(()),
    Hello(VERSION, "planner", "small"),
    Hello(99, "operator", "other"),
]
SEEDS = [
    *(packet(flags, encode(message)) for message in MESSAGES for flags in (0, FITTING | WAIT, BY_OPERATOR | WAIT)),
    *(packet(FITTING | WAIT, encode(message)) * 2 + packet(LONG, encode(Alive())) for message in MESSAGES),
    b"".join(packet(FITTING | WAIT, encode(message)) for message in MESSAGES),
    b"".join(packet(FITTING | LONG, encode(message)) for message in reversed(MESSAGES)),
    packet(0, b"\xff") + packet(0, b"") + packet(0, b"\x91" * 300) + packet(0, encode(["program", 1])),
]
numbers = st.integers(0, 12) | st.integers(0, 2**62)
times = st.floats(0, 0.3) | st.floats(-1e12, 1e12)
masks = st.integers(0, 63).map(lambda bits: bytes([bits])) | st.binary(max_size=3)
staged = st.lists(st.builds(Stage, masks, times, st.integers(-1, 5), times), max_size=5).map(tuple)
texts = st.text(max_size=8)
messages = st.one_of(
    st.sampled_from(MESSAGES),
    st.builds(Program, numbers, numbers, masks, times, staged, st.booleans(), st.booleans(), texts),
    st.builds(Replacement, numbers, numbers, numbers, masks, staged, st.booleans(), st.booleans()),
    st.builds(Setpoint, numbers, numbers, masks, st.lists(masks, max_size=4).map(tuple), times, st.booleans(), texts),
    st.builds(Lock, numbers, st.integers(0, 9_999), st.integers(-1, 1)),
    st.builds(Clearance, numbers, st.none() | texts),
    st.builds(Counts, st.lists(numbers, max_size=8).map(tuple)),
)
bodies = messages.map(encode) | st.binary(max_size=40)
any_packets = st.lists(st.builds(packet, st.integers(0, 15), bodies), max_size=20).map(b"".join)
