"""One boot with one failure, and the boots after it, until the board is ready or refused."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from typing import NamedTuple

from hyperbit.drivers.canopen.run.master import Master
from hyperbit.drivers.canopen.wire.cia301 import Frame, State
from hyperbit.drivers.simulation.objects import Objects
from tests.drivers.enumeration.failures import SDO_KINDS, Failure, Injection, failures
from tests.drivers.enumeration.histories import HISTORIES, LONGEST_BOOT, Before, histories
from tests.drivers.enumeration.rig import BUS, MASTER, NODE, TICK, TOOL, Copies, PinChange, Rig
from tests.drivers.variants.cases import Case

MOST_BOOTS = 6
AFTERWARDS = 0.5  # [s] in which a ready board must stay ready
LONGEST_WAIT, PROBED_EVERY = 5.0, 1.0  # [s] until a lost board is asked for again
REFUSALS = frozenset({"wrong-device", "sdo-refused", "board-error"})
UNHEARD = "neither booted nor answered"  # without an answer there is no object to name
OWN_OBJECTS = frozenset({0x1001, 0x1003, 0x6000})  # that the board itself changes
NAMED = re.compile(r"[0-9A-F]{4}h")


class Trial(NamedTuple):
    """One failure of one boot.

    Attributes:
        copies: of the rig before the boot.
    """

    case: Case
    before: Before
    failure: Failure
    copies: Copies

    @property
    def name(self) -> str:
        return f"{self.case.name}; {self.before.name}; {self.failure.kind}, {self.failure.at}: {self.failure.text}"


class Verdict(NamedTuple):
    """The result of a trial.

    Attributes:
        started: number of changes of pins by START of the master.
        energised: number of changes that energised a coil or a foreign output without a commit, except by another
            program, by the supply, or as `on_loss` says.
        moved: number of changes by the master of pins that hold on loss.
        broken: sentences on broken invariants, also those of `started` and `energised`.
    """

    started: int
    energised: int
    moved: int
    ready: bool
    boots: int
    broken: tuple[str, ...]


def trials(case: Case, every: int = 1, kind: str = "", chosen: Iterable[Before] = HISTORIES) -> Iterator[Trial]:
    """Yields each `every`-th trial of a board, in an order that is always the same."""
    number = 0
    for before, rig in histories(case, chosen):
        copies = Copies(rig)
        for failure in failures(frames_of_a_boot(copies)):
            number += kind in failure.kind
            if kind in failure.kind and number % every == 0:
                yield Trial(case, before, failure, copies)


def frames_of_a_boot(copies: Copies) -> list[tuple[str, Frame]]:
    rig = copies.copy()
    master = rig.start_master()
    rig.log.clear()
    rig.boot()
    assert rig.until(lambda: not master.booting, LONGEST_BOOT)
    return rig.log


def run(trial: Trial) -> Verdict:
    rig = trial.copies.copy()
    rig.changes.clear()
    holding = _holding(rig)
    rig.start_master()
    rig.interception = injection = Injection(trial.failure)
    broken: list[str] = []
    boots, ready = 0, False
    while not ready and boots < MOST_BOOTS:
        boots += 1
        broken += _boot(rig, injection, trial)
        ready = _stays_ready(rig)
        if not ready:
            _wait_until_back(rig)
            rig.run(TICK)  # the command of another program may still be on the bus
    if not injection.struck:
        broken.append("the failure did not happen")
    return _verdict(rig, holding, boots, ready, broken)


def _boot(rig: Rig, injection: Injection, trial: Trial) -> Iterator[str]:
    master, found = rig.master, _picture(rig)
    assert master is not None
    struck = injection.struck
    rig.boot()
    ended = rig.until(lambda: injection.event is not None or not master.booting, LONGEST_BOOT)
    if (event := injection.event) is not None:
        injection.event = None
        if event.mend is not None:
            rig.run(event.pause)
            event.mend(rig)
        if rig.master is not master:
            return  # the executor has died
        ended = rig.until(lambda: not master.booting, LONGEST_BOOT)
    if not ended:
        yield "the boot does not end"
    yield from _unclear_sentences(master, trial.failure)
    between = trial.failure.kind not in SDO_KINDS and struck != injection.struck
    if any(fault.code in REFUSALS for fault in master.boot_faults) and not between:
        yield from _left_changed(rig, found, master)


def _unclear_sentences(master: Master, failure: Failure) -> Iterator[str]:
    for fault in master.boot_faults:
        named = f"board {BUS}/{NODE}" in fault.message if fault.source != BUS else BUS in fault.message
        if not named:
            yield f"a sentence names no board: {fault.message}"
        if failure.kind in SDO_KINDS and UNHEARD not in fault.message and not NAMED.search(fault.message):
            yield f"a sentence names no object: {fault.message}"


class _Picture(NamedTuple):
    values: dict[tuple[int, int], bytes]
    state: State | None


def _picture(rig: Rig) -> _Picture:
    return _Picture(dict(rig.board.objects.values), rig.board.state)


def _left_changed(rig: Rig, found: _Picture, master: Master) -> Iterator[str]:
    """Yields the objects and the state that a refused boot has left in another way than it found them."""
    objects = rig.board.objects
    default = Objects(NODE, rig.variant, lambda index, sub: None)
    default.stored = objects.stored
    for key in sorted(found.values.keys() | objects.values.keys()):
        if key[0] in OWN_OBJECTS or key[0] == rig.variant.output_object:
            continue
        was, now = (values.get(key, default.get_data(*key)) for values in (found.values, objects.values))
        if was != now:
            text = f"{key[0]:04X}h/{key[1]} was {was.hex()} and is {now.hex()}"
            yield f"a refusal leaves an object changed: {text}: {_faults(master)}"
    if found.state is not None and rig.board.state is not found.state:
        text = f"it was {found.state.words} and is {rig.board.state and rig.board.state.words}"
        yield f"a refusal leaves the state changed: {text}: {_faults(master)}"


def _faults(master: Master) -> str:
    return "; ".join(fault.message for fault in master.boot_faults)


def _stays_ready(rig: Rig) -> bool:
    master = rig.master
    assert master is not None
    if not master.outputs_known:
        return False
    rig.run(AFTERWARDS)
    return master.outputs_known


def _wait_until_back(rig: Rig) -> None:
    """Waits until the buses and the board are back, as an executor does; an operator resets it in any case."""
    master, end = rig.master, rig.now + LONGEST_WAIT
    assert master is not None
    while rig.now < end and not rig.until(lambda: master.back, PROBED_EVERY):
        master.probe_silent(rig.now)


def _holding(rig: Rig) -> int:
    """Returns the mask of the pins that hold when the board loses its master, before and after the boot."""
    objects, lines = rig.board.objects, zip(rig.wiring.output_lines, rig.wiring.loss_levels, strict=True)
    holding = sum((objects.number(0x6206, sub) ^ 0xFF) << 8 * (sub - 1) for sub in objects.subs(0x6206))
    return holding & ~sum(1 << line.bit for line, level in lines if level is not None)


def _verdict(rig: Rig, holding: int, boots: int, ready: bool, broken: list[str]) -> Verdict:
    ours = [
        change
        for before, change in zip([None, *rig.changes], rig.changes, strict=False)
        if change.sender != TOOL and change.cause != "supply" and not _reverts(before, change)
    ]
    by_master = [change for change in ours if change.sender == MASTER]
    started = [change for change in by_master if change.cause == "START"]
    moved = [change for change in by_master if (change.on | change.off) & holding]
    energised = [change for change in ours if _energises(rig, change)]
    broken += [f"START has changed pins: {change}" for change in started]
    broken += [f"pins that hold have changed: {change}" for change in moved if change not in started]
    broken += [f"pins came on: {change}" for change in energised if change not in started]
    if ready and rig.master is not None and rig.master.outputs != rig.lines:
        broken.append(f"the master is wrong on the pins: it believes {rig.master.outputs:b}, not {rig.lines:b}")
    return Verdict(len(started), len(energised), len(moved), ready, boots, tuple(broken))


def _reverts(before: PinChange | None, change: PinChange) -> bool:
    """Returns whether a change puts the pins back as they were before a command of another program.

    The frame for what the board was before may be on its way when the command comes.
    """
    return before is not None and before.sender == TOOL and (before.on, before.off) == (change.off, change.on)


def _energises(rig: Rig, change: PinChange) -> int:
    """Returns the mask of the pins that energise a coil or a foreign output, except by the board at a loss."""
    lines = list(zip(rig.wiring.output_lines, rig.wiring.loss_levels, strict=True))
    inverted = sum(1 << line.bit for line, _ in lines if line.inverted)
    on_loss = sum(1 << line.bit for line, level in lines if level == 1 and change.sender != MASTER)
    return (change.on & ~inverted | change.off & inverted) & ~on_loss
