"""What a board is before a boot, as plain data for the judge."""

from __future__ import annotations

from typing import Any

from tests.simulation.judge.fieldbus.outcomes import PRE_OPERATIONAL, Found
from tests.simulation.judge.fieldbus.wires import JudgedBoard

WORDS = {0x0606_0000: "hardware error"}


def _state(board: Any) -> int | None:
    if board.silent or not board.powered:
        return None
    return PRE_OPERATIONAL if board.state is None else int(board.state)  # it boots in a moment


def found_of(board: Any, judged: JudgedBoard, explained: bool = True) -> Found:
    """Returns what SDO would read of a simulated board, and how it behaves; for `explained` see `Found`."""
    objects, variant = board.objects, board.variant
    values, writable = {}, set()
    for index, entries in objects.described.items():
        for sub, entry in entries.items():
            if entry.size <= 4:
                shown = objects.shown.get((index, sub))
                values[index, sub] = shown() if shown else objects.number(index, sub)
            if entry.writable:
                writable.add((index, sub))
    errors = tuple(reversed(board.emergencies.present))
    heartbeats, guards = objects.number(0x1017), objects.has(0x100C)
    return Found(
        state=_state(board),
        values=values,
        writable=frozenset(writable),
        deaf=objects.variant.deaf,
        refused={place: WORDS[code] for place, code in objects.refused.items()},
        synchronous=objects.variant.synchronous,
        starts=variant.starts or not any(code != 0x8130 or variant.keeps_loss for code in errors),
        errors=errors,
        keeps_loss=variant.keeps_loss,
        tells=bool(heartbeats or guards),
        explained=explained,
    )
