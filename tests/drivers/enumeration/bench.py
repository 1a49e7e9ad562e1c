"""One board on one bus with a master that may die: what happens to it before a boot. Copies of a bench are cheap."""

from __future__ import annotations

import io
import pickle
import struct
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from functools import partial
from random import Random
from types import FunctionType, MappingProxyType
from typing import NamedTuple

from hyperbit.drivers.canopen.wire import cia301
from hyperbit.drivers.canopen.wire.cia301 import Command, Frame
from hyperbit.drivers.canopen.wiring import BusWiring, Channel, Timing, Wiring
from hyperbit.drivers.simulation.firmware import SimulatedBoard
from hyperbit.drivers.simulation.variants import VARIANTS, Variant
from tests.drivers.rig import answering
from tests.drivers.variants.cases import Case
from tests.simulation.agenda import Agenda
from tests.simulation.buses.bus_model import BusModel
from tests.simulation.fieldbus.site import TOOL, Site

BUS, BITRATE, NODE = "can0", 1_000_000, 5
NAME = f"{BUS}/{NODE}"
LATENCY = 0.001  # [s] of an SDO answer
LOST = 1.0  # [s] after which the boards have lost the master
LONGEST_BOOT = 60.0  # [s], of a board with slow answers
SLOW = ("slow-answers", "late-boot")
OPPOSITE = {"hold": "contract", "contract": "hold"}


class PinChange(NamedTuple):
    """Masks of the output pins that came on or went off; for `cause` see `Site.sees`."""

    on: int
    off: int
    cause: str

    @property
    def by_master(self) -> bool:
        return self.cause not in ("time", "fault", TOOL)


class Bench(Site):
    """A board and its master.

    Attributes:
        log: frames of both since the last boot began, as they came.
        changes: changes of the pins since then.
    """

    def __init__(self, wiring: Wiring, timing: Timing, variant: Variant) -> None:
        self.changes: list[PinChange] = []
        self._pins = 0
        super().__init__(wiring, timing, {NAME: answering(variant, LATENCY)}, Agenda(), Random(0))
        self.log: list[Frame] = []
        self.bus.log = self.log

    @property
    def bus(self) -> BusModel:
        return self.buses[BUS]

    @property
    def it(self) -> SimulatedBoard:
        return self.board(NAME)

    def sees(self, cause: str, belongs_to: object) -> None:
        if cause == "read":
            return
        before, self._pins = self._pins, self.it.pins
        if self._pins != before:
            self.changes.append(PinChange(self._pins & ~before, before & ~self._pins, cause))

    @property
    def lines(self) -> int:
        """Levels of the output lines that the pins have."""
        lines = enumerate(self.wiring.output_lines)
        return sum((self.it.pins >> line.bit & 1 ^ line.inverted) << k for k, line in lines)

    def until(self, holds: Callable[[], object], longest: float) -> bool:
        """Runs until something holds, at most `longest` [s]; returns whether it holds."""
        end = self.now + longest
        while not holds() and self.now < end:
            self.agenda.step()
        return bool(holds())

    def write(self, index: int, sub: int, value: int) -> None:
        """Writes one byte, as another program does."""
        data = struct.pack("<BHBI", 0x2F, index, sub, value)
        self.boards.receive(BUS, Frame(cia301.SDO_REQUEST + NODE, data), TOOL)
        self.pass_time(0.01)

    def command(self, command: Command) -> None:
        self.order(NAME, command)

    def cycle_power(self) -> None:
        self.boards.fault("power_cut", NAME)
        self.boards.fault("power_on", NAME)


class Copies:
    """Copies of a bench without a master. Functions and descriptions of boards, which never change, are shared."""

    def __init__(self, bench: Bench) -> None:
        assert bench.running is None
        self._shared: list[object] = []
        buffer = io.BytesIO()
        _Pickler(buffer, self._shared).dump(bench)
        self._bytes = buffer.getvalue()

    def copy(self) -> Bench:
        unpickler = _Unpickler(io.BytesIO(self._bytes))
        unpickler.shared = self._shared
        bench: Bench = unpickler.load()
        return bench


class _Pickler(pickle.Pickler):
    def __init__(self, buffer: io.BytesIO, shared: list[object]) -> None:
        super().__init__(buffer, pickle.HIGHEST_PROTOCOL)
        self._shared, self._places = shared, dict[int, int]()

    def persistent_id(self, obj: object) -> int | None:
        if id(obj) not in self._places and isinstance(obj, FunctionType | MappingProxyType | Variant | Wiring | Timing):
            self._places[id(obj)] = len(self._shared)
            self._shared.append(obj)
            if isinstance(obj, Variant):
                self._places[id(obj.objects)] = len(self._shared)
                self._shared.append(obj.objects)
        return self._places.get(id(obj))


class _Unpickler(pickle.Unpickler):
    shared: list[object]

    def persistent_load(self, pid: int) -> object:
        return self.shared[pid]


class Before(NamedTuple):
    """What happens to a board between the end of an executor and the next boot.

    Attributes:
        other_loss: whether the executor before had the other `on_loss`.
    """

    name: str
    steps: tuple[Callable[[Bench], object], ...]
    other_loss: bool = False


def _wait(seconds: float) -> Callable[[Bench], object]:
    return lambda bench: bench.pass_time(seconds)


_STOP, _LEAVE = partial(Bench.command, command=Command.STOP), partial(Bench.command, command=Command.PRE_OPERATIONAL)
_STAY = partial(Bench.write, index=0x1029, sub=1, value=1)  # operational, in its error state
HISTORIES = (
    Before("executor dead until the board lost it", (_wait(LOST),)),
    Before("executor restarted at once", ()),
    Before("board power-cycled", (Bench.cycle_power, _wait(0.05))),
    Before("NMT 02h by a tool", (_STOP, _wait(0.01))),
    Before("NMT 80h by a tool", (_LEAVE, _wait(0.01))),
    Before("lost, then NMT 80h by a tool", (_wait(LOST), _LEAVE, _wait(0.01))),
    Before("lost, and on_loss changed", (_wait(LOST),), other_loss=True),
    Before("1029h is 1, then lost", (_STAY, _wait(LOST))),
)
FIRST_START = Before("first start", ())  # of a board that is refused


def histories(case: Case, chosen: Iterable[Before] = HISTORIES) -> Iterator[tuple[Before, Bench]]:
    """Yields a bench for each chosen history of a board, at the moment before a boot; no executor runs."""
    name = case.variant
    far = 64 if name == "many-outputs" else 1
    two = (Channel("5.left", BUS, NODE, 0, 0, input_contracted=1), Channel("5.right", BUS, NODE, far, None))
    wiring = Wiring((BusWiring(BUS, "none", BUS, BITRATE),), case.channels or two, **case.options)
    timing = Timing(boot_timeout=8.0 if name == "late-boot" else 2.0)
    for before in (FIRST_START,) if case.refused else chosen:
        bench = Bench(with_other_loss(wiring) if before.other_loss else wiring, timing, VARIANTS[name])
        bench.pass_time(0.05)
        if case.foreign_holds:
            bench.write(0x6206, 1, 0xFF & ~case.foreign)
        if not case.refused:
            if not extended(bench):
                continue
            bench.running = None
            if case.foreign:
                bench.write(bench.it.variant.output_object, 1, bench.it.pins & 0xFF | case.foreign)
            for step in before.steps:
                step(bench)
            bench.wiring = wiring
        yield before, bench


def extended(bench: Bench) -> bool:
    """Boots the board and switches its actuators; returns whether the board booted.

    All actuators are extended but each second one with two coils. Pulses stay on.
    """
    master = bench.start_master()
    master.boot(bench.now)
    assert bench.until(lambda: not master.booting.under_way, LONGEST_BOOT)
    if not master.outputs_known:
        return False
    count, states = len(bench.wiring.channels), (1 << len(bench.wiring.channels)) - 1
    for i, k in enumerate(bench.wiring.paired):
        if i % 2:
            states ^= 1 << k | 1 << count + i
    bench.commit(states)
    assert bench.until(lambda: not master.switching.under_way, 10.0)
    assert master.switching.failed is None
    assert bench.lines == states
    bench.pass_time(2 * bench.timing.travel_time + 0.2)
    return True


def with_other_loss(wiring: Wiring) -> Wiring:
    """Returns a wiring whose actuators without pulses have the other `on_loss`."""
    channels = tuple(
        replace(c, on_loss=OPPOSITE[c.on_loss]) if c.on_loss and c.pulse is None else c for c in wiring.channels
    )
    return replace(wiring, channels=channels, on_loss=OPPOSITE[wiring.on_loss])
