"""One simulated board, on a clock that the test sets."""

from __future__ import annotations

import struct

from hyperbit.drivers.canopen.wire import cia301
from hyperbit.drivers.canopen.wire.cia301 import Command
from hyperbit.drivers.simulation.actuator import Actuator
from hyperbit.drivers.simulation.firmware import SimulatedBoard, Wired
from hyperbit.drivers.simulation.variants import STANDARD, VARIANTS, Variant

Sent = list[tuple[int, str]]  # COB-ID and data in hexadecimal
SPARE = 7 * " 00"  # bytes of an RPDO or TPDO that carry nothing of these boards
EXTEND, OFF = "03" + SPARE, "00" + SPARE
BOOTED = (0x705, "00")
LOST, OVER = (0x085, "30 81 11 00 00 00 00 00"), (0x085, "00 00 00 00 00 00 00 00")
GUARD = cia301.REMOTE | 0x705


class Rig:
    """Board 5, with an actuator for each pair of an output and an input; its methods return its frames."""

    def __init__(self, variant: str | Variant = STANDARD, bits: tuple[tuple[int, int], ...] = ((0, 0), (1, 1))) -> None:
        self.now = 0.0
        self.sent: Sent = []
        self.actuators = [Actuator(f"{output}", 0.1) for output, _ in bits]
        wired = [Wired(a, output, input_) for a, (output, input_) in zip(self.actuators, bits, strict=True)]
        of = VARIANTS[variant] if isinstance(variant, str) else variant
        self.board = SimulatedBoard(5, wired, lambda cob_id, data: self.sent.append((cob_id, data.hex(" "))), of)
        self.board.power_on(0.0)

    def answers(self) -> Sent:
        sent, self.sent[:] = list(self.sent), []
        return sent

    def say(self, cob_id: int, data: str = "") -> Sent:
        self.board.receive(cob_id, bytes.fromhex(data), self.now)
        return self.answers()

    def wait(self, seconds: float) -> Sent:
        self.now += seconds
        self.board.step(self.now)
        return self.answers()

    def nmt(self, command: Command, node: int = 5) -> Sent:
        return self.say(0, bytes([command, node]).hex())

    def start(self) -> Sent:
        return self.nmt(Command.START)

    def sdo(self, request: str) -> str:
        """Returns the answer to an SDO request, both in hexadecimal; the request without its zeros at the end."""
        [(cob_id, answer)] = self.say(0x605, bytes.fromhex(request).ljust(8, b"\0").hex())
        assert cob_id == 0x585
        return answer

    def write(self, index: int, sub: int, value: int, size: int = 1) -> int:
        """Writes an object; returns the abort code, 0 if there is none."""
        data = value.to_bytes(size, "little").ljust(4, b"\0")
        raw = bytes.fromhex(self.sdo((struct.pack("<BHB", 0x23 | (4 - size) << 2, index, sub) + data).hex()))
        return int.from_bytes(raw[4:], "little") if raw[0] == 0x80 else 0

    def set(self, *writes: tuple[int, int, int, int]) -> None:
        for write in writes:
            assert self.write(*write) == 0

    def extend(self) -> None:
        self.start()
        self.say(0x205, EXTEND)
        assert self.board.pins == 3
        self.answers()

    def lose_master(self) -> None:
        """Supervises the master, which is heard once."""
        if self.board.objects.has(0x100C):
            self.set((0x100C, 0, 100, 2), (0x100D, 0, 3, 1))
            self.say(GUARD)
        else:
            self.set((0x1016, 1, 127 << 16 | 300, 4))
            self.say(0x77F, "05")
        assert LOST in self.wait(0.31)

    def driven(self) -> list[int]:
        return [actuator.coils[0] for actuator in self.actuators]

    def outputs(self) -> int:
        return self.board.objects.number(0x6200, 1)


def booted(variant: str | Variant = STANDARD) -> Rig:
    rig = Rig(variant)
    rig.answers()
    return rig
