"""The pins of a board before its start: START changes no pin.

START applies the stored outputs, 6200h, to the pins. In the error state the pins may differ from 6200h. So the boot
writes the known levels of the pins to 6200h, and "off" where the level is unknown. It does so before it overwrites
6206h and 6207h. From then on 6200h stores this knowledge, also for a later boot.

A byte may also have bits that hold. A restarted board has all outputs off, and the byte that was read before would
switch some on. So a byte with such bits is written in two steps, directly after it was read. A boot-up message reveals
a restart before the first step. After a later restart the board refuses the second step.
"""

from __future__ import annotations

from collections.abc import Generator
from typing import NamedTuple

from hyperbit.drivers.canopen.boot.inspection import Inspection
from hyperbit.drivers.canopen.pdo import OUTPUTS, subs_of, union
from hyperbit.drivers.canopen.sdo.client import SdoOutcome
from hyperbit.drivers.canopen.sdo.objects import Need
from hyperbit.drivers.canopen.sdo.procedure import BoardError, Step

_ALL = 0xFF


class ErrorMode(NamedTuple):
    """What one byte of outputs does in the error state."""

    taken: int  # mask of the bits that may take their error value; the others hold (6206h)
    value: int  # error value (6207h)
    told: bool  # both were read from the board; otherwise they follow from `error_state` of the arm's file


def settle(it: Inspection, stopped: bool, held: int | None) -> Generator[Step, SdoOutcome, bool]:
    """Writes the outputs so that START changes no pin. Call in pre-operational, before 6206h is overwritten.

    Args:
        stopped: whether the board was found stopped: then its pins have their error values.
        held: used output bits as this master commanded them, if the pins have held since; None: unknown.

    Returns:
        Whether the boot wrote outputs that the board may have switched itself.
    """
    layout, objects, written = it.layout, it.objects, False
    off = union(bit.place for bit in layout.outputs if bit.inverted)
    for sub in (yield from _subs(it)):
        used = layout.output_bits >> 8 * (sub - 1) & _ALL
        if not used and not (yield from objects.read(layout.settings.object, sub, fresh=True)):
            continue
        mode = yield from _error_mode(it, sub)
        value = mode.value if stopped and mode.told else off >> 8 * (sub - 1)
        for staged in (True, True, False):  # not each board takes a write in two steps
            present = yield from objects.read(layout.settings.object, sub, fresh=True)
            unsure = mode.taken & (mode.value ^ present)
            known = mode.told and held is not None and present & used == held >> 8 * (sub - 1) & _ALL
            if known or not (unsure or mode.taken & used):
                break
            need = Need(layout.settings.object, sub, value & unsure, 1, "outputs", mask=unsure)
            written |= not need.met(present)
            staged = staged and need.corrected(present) != 0
            # Written even if it is met: the object may show the command while the pins differ, or the pins while the
            # command differs.
            try:
                yield from objects.ensure(need, staged)
                break
            except BoardError:
                if not staged:
                    raise
    return written


def _subs(it: Inspection) -> Generator[Step, SdoOutcome, range]:
    """Returns the sub-indices of all output bytes of the board, also of unwired ones."""
    index = it.layout.settings.object
    count = it.objects.values.get((index, 0))
    if count is None:  # no output of the board is wired
        count = (yield from it.objects.find(index, 0)) or 0
    return range(1, 1 + max(count, *subs_of(it.layout.output_bits), 0))


def _error_mode(it: Inspection, sub: int) -> Generator[Step, SdoOutcome, ErrorMode]:
    """Reads what a byte of outputs does in the error state at present."""
    if it.layout.settings.object == OUTPUTS:
        mode = yield from it.objects.find(0x6206, sub)
        if mode is not None:
            value = (yield from it.objects.find(0x6207, sub)) if mode else 0
            return ErrorMode(mode, value or 0, told=value is not None)
    holds = it.layout.settings.error_state == "hold"
    return ErrorMode(0 if holds else _ALL, 0, told=False)
