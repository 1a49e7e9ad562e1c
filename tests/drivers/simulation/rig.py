"""One simulated board, on a clock that the test sets."""

from __future__ import annotations

import struct

from hyperbit.drivers.canopen.wire import cia301
from hyperbit.drivers.simulation.actuator import Actuator
from hyperbit.drivers.simulation.firmware import SimulatedBoard, Wired
from hyperbit.drivers.simulation.variants import STANDARD, VARIANTS, Variant

Sent = list[tuple[int, str]]  # COB-ID and data in hexadecimal


class Rig:
    """Board 5, with an actuator for each pair of an output and an input; its methods return its frames."""

    def __init__(self, *bits: tuple[int, int | None], variant: Variant = STANDARD) -> None:
        self.now = 0.0
        self.sent: Sent = []
        self.actuators = [Actuator(f"{output}", 0.1) for output, _ in bits]
        wired = [Wired(a, output, input_) for a, (output, input_) in zip(self.actuators, bits, strict=True)]
        self.board = SimulatedBoard(5, wired, lambda cob_id, data: self.sent.append((cob_id, data.hex(" "))), variant)
        self.board.power_on(0.0)

    def answers(self) -> Sent:
        sent, self.sent[:] = list(self.sent), []
        return sent

    def say(self, cob_id: int, data: bytes | str = b"") -> Sent:
        self.board.receive(cob_id, bytes.fromhex(data) if isinstance(data, str) else data, self.now)
        return self.answers()

    def wait(self, seconds: float) -> Sent:
        self.now += seconds
        self.board.step(self.now)
        return self.answers()

    def nmt(self, order: cia301.Command, node: int = 5) -> Sent:
        return self.say(0, bytes([order, node]))

    def sdo(self, request: str) -> str:
        """The answer to an SDO request, both in hexadecimal without the zeros at the end of the request."""
        [(cob_id, answer)] = self.say(0x605, bytes.fromhex(request).ljust(8, b"\0"))
        assert cob_id == 0x585
        return answer

    def write(self, index: int, sub: int, value: int, size: int = 1) -> int:
        data = value.to_bytes(size, "little").ljust(4, b"\0")
        raw = bytes.fromhex(self.sdo((struct.pack("<BHB", 0x23 | (4 - size) << 2, index, sub) + data).hex()))
        return int.from_bytes(raw[4:], "little") if raw[0] == 0x80 else 0

    def driven(self) -> list[int]:
        return [actuator.coils[0] for actuator in self.actuators]

    def outputs(self) -> int:
        return self.board.objects.number(0x6200, 1)


EXTEND = "03" + 7 * " 00"  # data of an RPDO


def booted(variant: str = "standard") -> Rig:
    """A board that has booted, with actuators on outputs 0 and 1 and their end-stops on inputs 0 and 1."""
    rig = Rig((0, 0), (1, 1), variant=VARIANTS[variant])
    rig.answers()
    return rig
