"""One boot with one failure, and the boots after it, until the board is ready or refused.

Each SDO transfer and each frame of a boot has all failures.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from functools import partial
from random import Random
from typing import NamedTuple

from hyperbit.drivers.canopen.run.master import Master
from hyperbit.drivers.canopen.wire import cia301
from hyperbit.drivers.canopen.wire.cia301 import Command, Frame, State
from hyperbit.drivers.simulation.objects import Objects
from tests.drivers.enumeration.bench import (
    BUS,
    HISTORIES,
    LONGEST_BOOT,
    NODE,
    Before,
    Bench,
    Copies,
    PinChange,
    histories,
)
from tests.drivers.variants.cases import Case
from tests.simulation.faults import boards, buses
from tests.simulation.faults.fault import Fault, Maker, Place
from tests.simulation.fieldbus.site import TICK, TOOL

LATE = 0.7  # [s] of a late answer, longer than the time-out of a request
SHORT, LONG = 0.1, 0.8  # [s]; the board loses the master only in the second
MOST_BOOTS = 6
AFTERWARDS = 0.5  # [s] in which a ready board must stay ready
LONGEST_WAIT, PROBED_EVERY = 5.0, 1.0  # [s] until a lost board is asked for again
REFUSALS = frozenset({"wrong-device", "sdo-refused", "board-error"})
UNHEARD = "neither booted nor answered"  # without an answer there is no object to name
OWN_OBJECTS = frozenset({0x1001, 0x1003, 0x6000})  # that the board itself changes
NAMED = re.compile(r"[0-9A-F]{4}h")
BETWEEN: dict[str, tuple[Maker, float]] = {  # rows of the table of faults, and how long each lasts [s]
    "bus is off, 0.1 s": (buses.bus_is_off, SHORT),
    "bus is off, 0.8 s": (buses.bus_is_off, LONG),
    **{f"NMT {c:02X}h by a tool": (partial(boards.another_master_commands, command=c), 0.0) for c in Command},
    "executor stalled 0.8 s": (partial(buses.executor_stands_still, long=LONG), 0.0),
    "board power-cycled": (partial(boards.board_restarts, off=0.0), 0.0),
    "executor restarted": (partial(buses.executor_is_killed, dead=0.0), 0.0),
    "executor dead 0.8 s": (partial(buses.executor_is_killed, dead=LONG), 0.0),
}
OF_REQUESTS = {  # of the n-th SDO request, or of its answer: what happens how often to the frame
    "request lost once": ("lose", 1, False),
    "request lost twice": ("lose", 2, False),
    "request lost three times": ("lose", 3, False),
    "answer lost once": ("lose", 1, True),
    "answer lost twice": ("lose", 2, True),
    "answer lost three times": ("lose", 3, True),
    "answer doubled": ("twice", 1, True),
    "answer late": ("late", 1, True),
}
OF_FRAMES = {"frame lost": "lose", "frame doubled": "twice"}


class Failure(NamedTuple):
    """One failure; `at`: ordinal of the SDO request, or of the frame that fails or after which it happens, from 1."""

    kind: str
    at: int
    text: str


def failures(log: Iterable[Frame]) -> Iterator[Failure]:
    frames = list(log)
    requests = [frame for frame in frames if frame.id & 0x780 == cia301.SDO_REQUEST]
    for kind in OF_REQUESTS:
        for at, frame in enumerate(requests, 1):
            index, sub = int.from_bytes(frame.data[1:3], "little"), frame.data[3]
            verb = "read" if frame.data[0] == 0x40 else "write"
            yield Failure(kind, at, "segment" if frame.data[0] & 0xE0 == 0 else f"{verb} {index:04X}h/{sub}")
    for kind in (*OF_FRAMES, *BETWEEN):
        for at, frame in enumerate(frames, 1):
            yield Failure(kind, at, f"{'after ' if kind in BETWEEN else ''}{frame.id:03X}h {frame.data.hex()}")


class Injection:
    """Causes one failure on a bench.

    Attributes:
        struck: whether it has happened; `over`: whether it has ended.
    """

    def __init__(self, failure: Failure, bench: Bench) -> None:
        self._failure, self._bench = failure, bench
        self.struck, self.over = False, failure.kind not in BETWEEN
        self._frames = self._requests = 0
        self._object = b""
        self._what, self._left, self._of_answer = OF_REQUESTS.get(failure.kind, ("", 0, False))
        bench.bus.late = LATE

    def intercept(self, frame: Frame) -> str:
        self._frames += 1
        if self._failure.kind in OF_REQUESTS:
            return self._of_request(frame)
        if self._frames != self._failure.at:
            return ""
        self.struck = True
        if self._failure.kind in OF_FRAMES:
            return OF_FRAMES[self._failure.kind]
        make, lasts = BETWEEN[self._failure.kind]
        fault = make(Place(self._bench, Random(0)))
        assert fault is not None
        self._bench.agenda.after(0.0, lambda: self._happen(fault, lasts))
        return ""

    def _happen(self, fault: Fault, lasts: float) -> None:
        fault.begin()
        self._bench.agenda.after(lasts, lambda: self._end(fault))

    def _end(self, fault: Fault) -> None:
        fault.end()
        self.over = True

    def _of_request(self, frame: Frame) -> str:
        request, answer = frame.id & 0x780 == cia301.SDO_REQUEST, frame.id & 0x780 == cia301.SDO_ANSWER
        self._requests += request
        if request and self._requests == self._failure.at and not self._object:
            segment = self._of_answer and frame.data[0] & 0xE0 == 0
            self._object = bytes(3) if segment else frame.data[1:4]
        if not self._left or not self._object or frame.data[1:4] != self._object:
            return ""
        if not (answer if self._of_answer else request):
            return ""
        self._left, self.struck = self._left - 1, True
        return self._what


class Trial(NamedTuple):
    """One failure of one boot; `copies` of the bench before the boot."""

    case: Case
    before: Before
    failure: Failure
    copies: Copies

    @property
    def name(self) -> str:
        return f"{self.case.name}; {self.before.name}; {self.failure.kind}, {self.failure.at}: {self.failure.text}"


class Verdict(NamedTuple):
    """`ready`: whether the board is ready at the end; `broken`: sentences on broken invariants."""

    ready: bool
    broken: tuple[str, ...]


def trials(case: Case, every: int = 1, kind: str = "", chosen: Iterable[Before] = HISTORIES) -> Iterator[Trial]:
    """Yields each `every`-th trial of a board, in an order that is always the same."""
    number = 0
    for before, bench in histories(case, chosen):
        copies = Copies(bench)
        for failure in failures(frames_of_a_boot(copies)):
            number += kind in failure.kind
            if kind in failure.kind and number % every == 0:
                yield Trial(case, before, failure, copies)


def frames_of_a_boot(copies: Copies) -> list[Frame]:
    bench = copies.copy()
    master = bench.start_master()
    bench.log.clear()
    master.boot(bench.now)
    assert bench.until(lambda: not master.booting.under_way, LONGEST_BOOT)
    return bench.log


def run(trial: Trial) -> Verdict:
    bench = trial.copies.copy()
    bench.changes.clear()
    holding = _holding(bench)
    bench.start_master()
    injection = Injection(trial.failure, bench)
    bench.bus.intercept = injection.intercept
    broken: list[str] = []
    boots, ready = 0, False
    while not ready and boots < MOST_BOOTS:
        boots += 1
        broken += _boot(bench, injection, trial.failure)
        ready = _stays_ready(bench)
        if not ready:
            _wait_until_back(bench)
            bench.pass_time(TICK)  # the command of another program may still be on the bus
    if not injection.struck:
        broken.append("the failure did not happen")
    return _verdict(bench, holding, ready, broken)


def _boot(bench: Bench, injection: Injection, failure: Failure) -> Iterator[str]:
    found, struck = _picture(bench), injection.struck
    bench.call(lambda master: master.boot(bench.now))

    def over() -> bool:
        rests = bench.running is not None and not bench.stalled and not bench.master.booting.under_way
        return rests and (injection.over or not injection.struck)

    ended = bench.until(over, LONGEST_BOOT)
    if not ended:
        yield "the boot does not end"
    yield from _unclear_sentences(bench.master, failure)
    between = failure.kind not in OF_REQUESTS and struck != injection.struck
    if any(fault.code in REFUSALS for fault in bench.master.booting.faults) and not between:
        yield from _left_changed(bench, found)


def _unclear_sentences(master: Master, failure: Failure) -> Iterator[str]:
    for fault in master.booting.faults:
        named = f"board {BUS}/{NODE}" in fault.message if fault.source != BUS else BUS in fault.message
        if not named:
            yield f"a sentence names no board: {fault.message}"
        if failure.kind in OF_REQUESTS and UNHEARD not in fault.message and not NAMED.search(fault.message):
            yield f"a sentence names no object: {fault.message}"


class _Picture(NamedTuple):
    values: dict[tuple[int, int], bytes]
    state: State | None


def _picture(bench: Bench) -> _Picture:
    return _Picture(dict(bench.it.objects.values), bench.it.state)


def _left_changed(bench: Bench, found: _Picture) -> Iterator[str]:
    """Yields the objects and the state that a refused boot has left in another way than it found them."""
    objects, variant = bench.it.objects, bench.it.variant
    why = "; ".join(fault.message for fault in bench.master.booting.faults)
    default = Objects(NODE, variant, lambda index, sub: None)
    default.stored = objects.stored
    for key in sorted(found.values.keys() | objects.values.keys()):
        if key[0] in OWN_OBJECTS or key[0] == variant.output_object:
            continue
        was, now = (values.get(key, default.get_data(*key)) for values in (found.values, objects.values))
        if was != now:
            yield f"a refusal leaves an object changed: {key[0]:04X}h/{key[1]} was {was.hex()}, is {now.hex()}: {why}"
    if found.state is not None and bench.it.state is not found.state:
        yield f"a refusal leaves the state changed: it was {found.state.words} and is {bench.it.state}: {why}"


def _stays_ready(bench: Bench) -> bool:
    if bench.master.outputs_known:
        bench.pass_time(AFTERWARDS)
    return bench.master.outputs_known


def _wait_until_back(bench: Bench) -> None:
    """Waits until the buses and the board are back, as an executor does; an operator resets it in any case."""
    end = bench.now + LONGEST_WAIT
    while bench.now < end and not bench.until(lambda: bench.master.back, PROBED_EVERY):
        bench.call(lambda master: master.probe_silent(bench.now))


def _holding(bench: Bench) -> int:
    """Returns the mask of the pins that hold when the board loses its master, before and after the boot."""
    objects, lines = bench.it.objects, zip(bench.wiring.output_lines, bench.wiring.loss_levels, strict=True)
    holding = sum((objects.number(0x6206, sub) ^ 0xFF) << 8 * (sub - 1) for sub in objects.subs(0x6206))
    return holding & ~sum(1 << line.bit for line, level in lines if level is not None)


def _verdict(bench: Bench, holding: int, ready: bool, broken: list[str]) -> Verdict:
    ours = [
        change
        for before, change in zip([None, *bench.changes], bench.changes, strict=False)
        if change.cause not in (TOOL, "fault") and not _reverts(before, change)
    ]
    started = [change for change in ours if change.cause == "START"]
    moved = [change for change in ours if change.by_master and (change.on | change.off) & holding]
    energised = [change for change in ours if _energises(bench, change)]
    broken += [f"START has changed pins: {change}" for change in started]
    broken += [f"pins that hold have changed: {change}" for change in moved if change not in started]
    broken += [f"pins came on: {change}" for change in energised if change not in started]
    if ready and (believed := bench.master.outputs.commanded) != bench.lines:
        broken.append(f"the master is wrong on the pins: it believes {believed:b}, not {bench.lines:b}")
    return Verdict(ready, tuple(broken))


def _reverts(before: PinChange | None, change: PinChange) -> bool:
    """Returns whether a change puts the pins back as they were before a command of another program.

    The frame for what the board was before may be on its way when the command comes.
    """
    return before is not None and before.cause == TOOL and (before.on, before.off) == (change.off, change.on)


def _energises(bench: Bench, change: PinChange) -> int:
    """Returns the mask of the pins that energise a coil or a foreign output, except by the board at a loss."""
    lines = list(zip(bench.wiring.output_lines, bench.wiring.loss_levels, strict=True))
    inverted = sum(1 << line.bit for line, _ in lines if line.inverted)
    on_loss = sum(1 << line.bit for line, level in lines if level == 1 and not change.by_master)
    return (change.on & ~inverted | change.off & inverted) & ~on_loss
