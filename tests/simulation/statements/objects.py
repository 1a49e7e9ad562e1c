"""The statement on the objects of boards."""

from __future__ import annotations

from collections.abc import Callable

from tests.simulation.statements.account import Account
from tests.simulation.statements.statement import Statement

MASTER = 127
NEEDED = {0x1005, 0x1006, 0x1007, 0x1019, 0x1014, 0x1016, 0x1017, 0x100C, 0x100D, 0x1029, 0x6005}


class BoardObjects(Statement):
    """A ready board has the objects that the drivers' page needs; a boot changes nothing else."""

    number = 17

    def __init__(self, account: Account) -> None:
        super().__init__(account)
        arm = account.world.arm
        self._timing = arm.timing
        wiring = arm.wiring
        self._bases = {f"{node.bus}/{node.node}": node.object for node in wiring.nodes}
        self._used: dict[str, tuple[int, int]] = {}  # of each board, masks of the used output bits and input bits
        self._loss: dict[str, tuple[int, int]] = {}  # of each board, output bits with a loss level, and these levels
        for line, level in zip(wiring.output_lines, wiring.loss_levels, strict=True):
            self._use(f"{line.bus}/{line.node}", 1 << line.bit, 0)
            if level is not None:
                taken, levels = self._loss.get(f"{line.bus}/{line.node}", (0, 0))
                bit = 1 << line.bit
                self._loss[f"{line.bus}/{line.node}"] = taken | bit, levels | bit * (level != line.inverted)
        for line in wiring.input_lines:
            if line is not None:
                self._use(f"{line.bus}/{line.node}", 0, 1 << line.bit)

    def used(self, board: str) -> tuple[int, int]:
        """Returns the masks of the used output bits and input bits of a board."""
        return self._used[board]

    def base(self, board: str) -> int:
        return self._bases.get(board, 0x6200)

    def _use(self, board: str, outputs: int, inputs: int) -> None:
        before = self._used.get(board, (0, 0))
        self._used[board] = before[0] | outputs, before[1] | inputs

    def judge(self, board: str) -> None:
        """Judges the objects of a board that was booted."""
        objects = self.account.world.boards.simulated.board(board).objects
        has, number = objects.has, objects.number

        def needs(index: int, sub: int, value: int, mask: int = -1) -> None:
            found = number(index, sub)
            text = f"board {board} has {found:X}h in {index:04X}h sub {sub}; {value:X}h is needed, mask {mask:X}h"
            self.require(not has(index) or (found ^ value) & mask == 0, text)

        (outputs, inputs), (taken, levels) = self._used[board], self._loss.get(board, (0, 0))
        self._judge_supervision(board, has, number)
        needs(0x1005, 0, 0x80, 0x7FFF_FFFF)
        needs(0x1006, 0, 0)
        needs(0x1007, 0, 0)
        needs(0x1019, 0, 0)
        needs(0x1014, 0, 0x80 + int(board.split("/")[1]))
        needs(0x1029, 1, 2 if taken else 0)
        for sub in range(1, 33):
            shift = 8 * (sub - 1)
            used, sensed = outputs >> shift & 0xFF, inputs >> shift & 0xFF
            if used:
                needs(0x6202, sub, 0, used)
                needs(0x6206, sub, taken >> shift & 0xFF, used)
                needs(0x6207, sub, levels >> shift & 0xFF, taken >> shift & 0xFF)
                needs(0x6208, sub, used, used)
            if sensed:
                needs(0x6005, 0, 1)
                needs(0x6006, sub, sensed, sensed)

    def judge_kept(self, board: str, before: dict[tuple[int, int], int], after: dict[tuple[int, int], int]) -> None:
        """Requires that a boot has changed only what the wiring needs, from all values before it and after it."""
        (outputs, inputs), (taken, _) = self._used[board], self._loss.get(board, (0, 0))
        used = {0x6206: outputs, 0x6207: taken, 0x6208: outputs, 0x6006: inputs}
        watched = [after[key] ^ value for key, value in before.items() if key[0] == 0x1016 and key[1]]
        self.require(sum(map(bool, watched)) <= 1, f"board {board}: {watched} have changed in 1016h")
        for (index, sub), value in before.items():
            changed = value ^ after[index, sub]
            text = f"board {board}: {index:04X}h sub {sub} was {value:X}h, and is {after[index, sub]:X}h after the boot"
            if index in used and sub:
                self.require(not changed & ~(used[index] >> 8 * (sub - 1)), text)
            elif changed and index != self.base(board):
                self.require(index in NEEDED or 0x1400 <= index < 0x1C00, text)
            if index == 0x1016 and sub and changed and value & 0xFFFF and value >> 16 & 0x7F != MASTER:
                free = [key for key, entry in before.items() if key[0] == 0x1016 and key[1] and not entry & 0xFFFF]
                self.require(not free, f"{text}; {free} were free")

    def _judge_supervision(self, board: str, has: Callable[[int], bool], number: Callable[[int, int], int]) -> None:
        timeout = round(1000 * self._timing.heartbeat_timeout)
        if has(0x1016) and number(0x1017, 0):
            entries = [number(0x1016, sub) for sub in range(1, number(0x1016, 0) + 1)]
            watched = [entry & 0xFFFF for entry in entries if entry >> 16 & 0xFF == MASTER]
            right = len(watched) == 1 and timeout - 10 <= watched[0] <= timeout
            self.require(right, f"board {board} watches node 127 for {watched} ms, of {entries}")
            period = round(1000 * self._timing.heartbeat)
            self.require(
                period - 10 < number(0x1017, 0) <= period, f"board {board} has a heartbeat of {number(0x1017, 0)} ms"
            )
        else:
            life = number(0x100C, 0) * number(0x100D, 0)
            self.require(
                timeout - 10 < life <= timeout + 1000 * self._timing.heartbeat, f"board {board} is guarded {life} ms"
            )
