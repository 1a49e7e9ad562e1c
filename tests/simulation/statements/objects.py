"""The statement on the objects of boards, and the values that a boot must leave in them."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping

from tests.simulation.statements.account import Account
from tests.simulation.statements.boards import INPUTS, OUTPUTS, JudgedBoard, bytes_of
from tests.simulation.statements.statement import Statement

MASTER = 127
LIVE = frozenset({0x1001, 0x1002, 0x1003, INPUTS})  # objects that a board changes by itself
TIMES = frozenset({0x1017, 0x100C, 0x100D})  # a board may round them
ROUNDING = 10  # [ms] by which boards round times
ALL = 0xFFFF_FFFF
Place = tuple[int, int]  # index and sub-index
Values = Mapping[Place, int]


def heartbeats(has: Callable[[int, int], bool]) -> bool:
    """Returns whether heartbeats supervise a board; else node guarding does."""
    return has(0x1016, 1) and has(0x1017, 0)


def needs_of(board: JudgedBoard, has: Callable[[int, int], bool]) -> dict[Place, tuple[int, int]]:
    """Returns the needed values of a board's objects but times and PDOs, with masks of the bits that matter."""
    needs = {(0x1005, 0): (0x80, ALL >> 1), (0x1029, 1): (2 if board.taken else 0, ALL)}
    needs |= {(index, 0): (0, ALL) for index in (0x1006, 0x1007, 0x1019)}
    needs[0x1014, 0] = 0x80 + board.node, ALL
    if heartbeats(has):
        needs |= {(index, 0): (0, ALL) for index in (0x100C, 0x100D)}
    elif not has(0x1016, 1):
        needs[0x1017, 0] = 0, ALL
    for sub in bytes_of(board.used) if board.base == OUTPUTS else ():
        used, taken, levels = (bits >> 8 * (sub - 1) & 0xFF for bits in (board.used, board.taken, board.levels))
        needs |= {(0x6208, sub): (used, used), (0x6206, sub): (taken, used)}
        if taken:
            needs[0x6207, sub] = levels & taken, taken
    for sub in bytes_of(board.sensed):
        sensed = board.sensed >> 8 * (sub - 1) & 0xFF
        needs |= {(0x6005, 0): (1, ALL), (0x6006, sub): (sensed, sensed)}
    return {place: need for place, need in needs.items() if has(*place)}


class BoardObjects(Statement):
    """A ready board has the objects that the drivers' page needs; a boot changes nothing else."""

    number = 17

    def __init__(self, account: Account) -> None:
        super().__init__(account)
        self._world = account.world

    def judge(self, name: str) -> None:
        """Judges the objects of a board that was booted."""
        board, look = self._world.sight.wiring.boards[name], self._world.sight.looks[name]
        needs = needs_of(board, look.has)
        for sub in bytes_of(board.used) if board.base == OUTPUTS else ():
            needs[0x6202, sub] = 0, board.used >> 8 * (sub - 1) & 0xFF
        for (index, sub), (value, mask) in needs.items():
            found = look.number(index, sub)
            text = f"board {name} has {found:X}h in {index:04X}h sub {sub}; {value:X}h is needed, mask {mask:X}h"
            self.require((found ^ value) & mask == 0, text)
        self._judge_supervision(name)

    def judge_kept(self, name: str, before: Values, after: Values) -> None:
        """Requires that a boot has changed only what the wiring needs, from all values before it and after it."""
        board = self._world.sight.wiring.boards[name]
        needs = needs_of(board, lambda *place: place in before)
        changed = {place: value ^ after[place] for place, value in before.items() if place[0] not in LIVE | TIMES}
        watched = [place for place, bits in changed.items() if place[0] == 0x1016 and bits]
        self.require(len(watched) <= 1, f"board {name}: {watched} have changed in 1016h")
        others = [place for place in watched if before[place] & 0xFFFF and before[place] >> 16 & 0x7F != MASTER]
        free = [place for place, value in before.items() if place[0] == 0x1016 and place[1] and not value & 0xFFFF]
        self.require(not (others and free), f"board {name}: {others} watched others, and {free} were free")
        for (index, sub), bits in changed.items():
            if index in (0x1016, board.base) or 0x1400 <= index < 0x1C00:
                continue
            _, mask = needs.get((index, sub), (0, 0))
            text = f"board {name}: {index:04X}h sub {sub} was {before[index, sub]:X}h, and has changed by {bits:X}h"
            self.require(not bits & ~mask, text)

    def _judge_supervision(self, name: str) -> None:
        look, timing = self._world.sight.looks[name], self._world.timing
        timeout, period = round(1000 * timing.heartbeat_timeout), round(1000 * timing.heartbeat)
        if heartbeats(look.has):
            entries = [look.number(0x1016, sub) for sub in range(1, look.number(0x1016, 0) + 1)]
            watched = [entry & 0xFFFF for entry in entries if entry >> 16 & 0xFF == MASTER]
            right = len(watched) == 1 and timeout - ROUNDING < watched[0] <= timeout
            self.require(right, f"board {name} watches node 127 for {watched} ms, of {entries}")
            produced = look.number(0x1017, 0)
            self.require(period - ROUNDING < produced <= period, f"board {name} has a heartbeat of {produced} ms")
        else:
            factor, life = look.number(0x100D, 0), look.number(0x100C, 0) * look.number(0x100D, 0)
            right = factor == math.ceil(timeout / period)
            right &= timeout - ROUNDING * factor < life <= timeout + period
            self.require(right, f"board {name} is guarded {life} ms, in {factor} times")
