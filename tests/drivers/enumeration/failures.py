"""Single failures of a boot: each SDO transfer and each frame of a boot has all of them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from typing import NamedTuple

from hyperbit.drivers.canopen.wire import cia301
from hyperbit.drivers.canopen.wire.cia301 import Command, Frame
from tests.drivers.enumeration.rig import BOARD, MASTER, Rig

LATE = 0.7  # [s] of a late answer, longer than the timeout of a request
_SHORT, _LONG = 0.1, 0.8  # [s]; the board loses the master only in the second


class Failure(NamedTuple):
    """One failure.

    Attributes:
        kind: a key of `SDO_KINDS`, of `WIRE_KINDS` or of `FRAME_KINDS`.
        at: ordinal of the SDO request, or of the frame after which it happens, from 1.
    """

    kind: str
    at: int
    text: str


class Event(NamedTuple):
    """Something that happens between two frames; `mend` follows after `pause` [s]."""

    happen: Callable[[Rig], None]
    pause: float = 0.0
    mend: Callable[[Rig], None] | None = None


def _command(command: Command) -> Event:
    return Event(lambda rig: rig.command(command))


def _end_executor(rig: Rig) -> None:
    rig.master = None


def _start_executor(rig: Rig) -> None:
    rig.start_master()


def _go_off(rig: Rig) -> None:
    rig.set_bus("bus-off")


def _come_back(rig: Rig) -> None:
    rig.set_bus("active")


def _stand_still(rig: Rig) -> None:
    rig.stalled = True


def _go_on(rig: Rig) -> None:
    rig.go_on()


FRAME_KINDS = {
    "bus-off, 0.1 s": Event(_go_off, _SHORT, _come_back),
    "bus-off, 0.8 s": Event(_go_off, _LONG, _come_back),
    "NMT 01h by a tool": _command(Command.START),
    "NMT 02h by a tool": _command(Command.STOP),
    "NMT 80h by a tool": _command(Command.PRE_OPERATIONAL),
    "NMT 81h by a tool": _command(Command.RESET_NODE),
    "NMT 82h by a tool": _command(Command.RESET_COMMUNICATION),
    "executor stalled 0.8 s": Event(_stand_still, _LONG, _go_on),
    "board power-cycled": Event(Rig.power_cycle),
    "executor restarted": Event(_end_executor, 0.0, _start_executor),
    "executor dead 0.8 s": Event(_end_executor, _LONG, _start_executor),
}
SDO_KINDS = {  # the frame that fails, how often, and the delays of its deliveries
    "request lost once": (MASTER, 1, ()),
    "request lost twice": (MASTER, 2, ()),
    "request lost three times": (MASTER, 3, ()),
    "answer lost once": (BOARD, 1, ()),
    "answer lost twice": (BOARD, 2, ()),
    "answer lost three times": (BOARD, 3, ()),
    "answer doubled": (BOARD, 1, (0.0, 0.0)),
    "answer late": (BOARD, 1, (LATE,)),
}
WIRE_KINDS: dict[str, tuple[float, ...]] = {"frame lost": (), "frame doubled": (0.0, 0.0)}  # delays of deliveries
KINDS = (*SDO_KINDS, *WIRE_KINDS, *FRAME_KINDS)


class Injection:
    """Causes one failure on a rig.

    Attributes:
        event: a failure between two frames that has happened, and is not mended.
    """

    def __init__(self, failure: Failure) -> None:
        self._failure = failure
        self.struck = False
        self.event: Event | None = None
        self._frames = self._requests = 0
        self._object = b""
        self._sender, self._left, self._delays = SDO_KINDS.get(failure.kind, ("", 0, ()))
        self._between = FRAME_KINDS.get(failure.kind)
        self._wire = WIRE_KINDS.get(failure.kind)

    def delays(self, sender: str, frame: Frame) -> tuple[float, ...]:
        """Returns the delay of each delivery of a frame [s]."""
        if self._wire is not None and self._frames + 1 == self._failure.at:
            self.struck = True
            return self._wire
        if not self._left:
            return (0.0,)
        if is_request(sender, frame):
            self._requests += 1
            if self._requests == self._failure.at:
                answer_to_segment = self._sender == BOARD and _is_segment(frame)
                self._object = bytes(3) if answer_to_segment else frame.data[1:4]
        wanted = is_request(sender, frame) if self._sender == MASTER else _is_answer(sender, frame)
        if not wanted or not self._object or frame.data[1:4] != self._object:
            return (0.0,)
        self._left -= 1
        self.struck = True
        return self._delays

    def delivered(self, rig: Rig) -> None:
        self._frames += 1
        if self._between is not None and self._frames == self._failure.at:
            self.struck, self.event = True, self._between
            self._between.happen(rig)


def is_request(sender: str, frame: Frame) -> bool:
    return sender == MASTER and frame.id & 0x780 == cia301.SDO_REQUEST


def _is_answer(sender: str, frame: Frame) -> bool:
    return sender == BOARD and frame.id & 0x780 == cia301.SDO_ANSWER


def _is_segment(frame: Frame) -> bool:
    return frame.data[0] & 0xE0 == 0


def failures(log: Iterable[tuple[str, Frame]]) -> Iterator[Failure]:
    frames = list(log)
    requests = [frame for sender, frame in frames if is_request(sender, frame)]
    for kind in SDO_KINDS:
        for at, frame in enumerate(requests, 1):
            index, sub = int.from_bytes(frame.data[1:3], "little"), frame.data[3]
            verb = "read" if frame.data[0] == 0x40 else "write"
            yield Failure(kind, at, "segment" if _is_segment(frame) else f"{verb} {index:04X}h/{sub}")
    for kind in (*WIRE_KINDS, *FRAME_KINDS):
        for at, (_, frame) in enumerate(frames, 1):
            yield Failure(kind, at, f"{'' if kind in WIRE_KINDS else 'after '}{frame.id:03X}h {frame.data.hex()}")
