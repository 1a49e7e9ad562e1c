"""Boards: the objects that a boot must leave, and what the boards do at the end and the loss of the executor."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from tests.simulation.judge.account import Account
from tests.simulation.judge.arm import mask_of, merged
from tests.simulation.judge.verdict import require

MASTER = 127
NEEDED = {0x1005, 0x1006, 0x1007, 0x1019, 0x1014, 0x1016, 0x1017, 0x100C, 0x100D, 0x1029, 0x6005}
LOST_LATE = 0.03  # [s] after `heartbeat_timeout` until a board acts on the loss of its master: its clock rounds


class BoardObjects:
    """What the drivers' page needs in the objects of the boards of an arm."""

    def __init__(self, arm: Any) -> None:
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

    def judge(self, board: str, has: Callable[[int], bool], number: Callable[[int, int], int]) -> None:
        """Judges the objects of a board that was booted."""

        def needs(index: int, sub: int, value: int, mask: int = -1) -> None:
            found = number(index, sub)
            text = f"board {board} has {found:X}h in {index:04X}h sub {sub}; {value:X}h is needed, mask {mask:X}h"
            require(not has(index) or (found ^ value) & mask == 0, text)

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
        require(sum(map(bool, watched)) <= 1, f"board {board}: {watched} have changed in 1016h")
        for (index, sub), value in before.items():
            changed = value ^ after[index, sub]
            text = f"board {board}: {index:04X}h sub {sub} was {value:X}h, and is {after[index, sub]:X}h after the boot"
            if index in used and sub:
                require(not changed & ~(used[index] >> 8 * (sub - 1)), text)
            elif changed and index != self.base(board):
                require(index in NEEDED or 0x1400 <= index < 0x1C00, text)
            if index == 0x1016 and sub and changed and value & 0xFFFF and value >> 16 & 0x7F != MASTER:
                free = [key for key, entry in before.items() if key[0] == 0x1016 and key[1] and not entry & 0xFFFF]
                require(not free, f"{text}; {free} were free")

    def _judge_supervision(self, board: str, has: Callable[[int], bool], number: Callable[[int, int], int]) -> None:
        timeout = round(1000 * self._timing.heartbeat_timeout)
        if has(0x1016) and number(0x1017, 0):
            entries = [number(0x1016, sub) for sub in range(1, number(0x1016, 0) + 1)]
            watched = [entry & 0xFFFF for entry in entries if entry >> 16 & 0xFF == MASTER]
            right = len(watched) == 1 and timeout - 10 <= watched[0] <= timeout
            require(right, f"board {board} watches node 127 for {watched} ms, of {entries}")
            period = round(1000 * self._timing.heartbeat)
            require(
                period - 10 < number(0x1017, 0) <= period, f"board {board} has a heartbeat of {number(0x1017, 0)} ms"
            )
        else:
            life = number(0x100C, 0) * number(0x100D, 0)
            require(
                timeout - 10 < life <= timeout + 1000 * self._timing.heartbeat, f"board {board} is guarded {life} ms"
            )


class Endings:
    """Judges what becomes of the actuators when an executor ends.

    Attributes:
        goes_off: boards without 6206h whose device switches all outputs off when the executor is lost, by the arm's
            file (`error_state`); the world sets it.
    """

    def __init__(self, account: Account, arm: Any) -> None:
        self._a = account
        wiring, on_loss = arm.wiring, arm.wiring.on_loss
        self.lets_go = mask_of(
            k for k, c in enumerate(wiring.channels) if c.pulse is None and (c.on_loss or on_loss) == "contract"
        )
        self.goes_off: set[str] = set()
        self._off = mask_of(k for k, c in enumerate(wiring.channels) if c.output_off is None)
        self._extended_off = mask_of(k for k, c in enumerate(wiring.channels) if "output" in c.inverted)
        self._contracts = False
        self._ended: tuple[float, int] | None = None
        self._quit_at, self._unknown = 0.0, 0
        self._at_once = self._warned = False  # asked to end at once; the log has told that the arm is not contracted
        self._longest = arm.ending

    @property
    def let_go(self) -> int:
        """Mask of the actuators that their boards contract without the executor."""
        off = self._off & mask_of(k for k, board in enumerate(self._a.arm.board_of) if board in self.goes_off)
        return self.lets_go | off

    def quits(self) -> None:
        a = self._a
        if a.quitting:  # a second call: it ends now
            return
        self._at_once = self._warned = False
        ready = a.clear and a.mode in ("ready", "executing")
        self._contracts, self._unknown = a.arm.contracts_at_end and ready, a.homing & a.unknown
        self._quit_at = a.now

    def hurries(self) -> None:
        self._contracts, self._at_once = False, True

    def logs(self, text: str) -> None:
        """Takes a line of the log: it tells if the arm is not contracted."""
        self._warned |= "contract" in text and "before the end" in text

    def interferes(self) -> None:
        """A stop or a cancel came, which ends a contraction."""
        self._contracts = False

    def tick(self) -> None:
        """Finds an executor that does not end."""
        a = self._a
        if a.quitting and a.clear:
            longest = (self._longest if a.arm.contracts_at_end else 0.0) + 1.0 + max(a.arm.pulse.values(), default=0.0)
            require(a.now - self._quit_at <= longest, f"the executor does not end within {longest:g} s")

    def dies(self) -> None:
        """The executor has ended, in order or by a kill."""
        a = self._a
        states = a.ground.states
        if a.clear and a.quitting and self._contracts:
            left = states & ~a.locked & ~(a.homing & ~a.unknown)
            require(not left, f"on_stop is contract, and {left:b} are extended at the end")
            moving = a.ground.surely_moving(a.now)
            require(not moving, f"on_stop is contract, and {moving:b} travel at the end")
            left = self._unknown & ~a.ground.came_since(self._quit_at)
            require(not left, f"on_stop is contract, and the unknown states of {left:b} are never brought there")
        if a.clear and a.quitting and a.arm.contracts_at_end and states & ~a.locked & ~a.homing:
            require(self._warned, f"the arm is not contracted at the end: {states:b}, and the log does not tell it")
        if a.clear and a.quitting and not self._at_once:
            on = a.ground.on & mask_of(a.arm.pulse)
            require(not on, f"the executor has ended in order, and the pulses of {on:b} are on")
        self._ended = (a.now, states) if a.clear and not a.committing else None
        self._contracts = False

    def begins(self) -> None:
        """The next executor starts: until now only the boards could switch anything."""
        a, ended, self._ended = self._a, self._ended, None
        if ended is None or not a.clear:
            return
        died_at, states = ended
        timing = a.arm.timing
        off = self._off & mask_of(k for k, board in enumerate(a.arm.board_of) if board in self.goes_off)
        if a.now - died_at > timing.heartbeat_timeout + timing.heartbeat + LOST_LATE:
            states = merged(off, self._extended_off, states & ~self.lets_go)
            wrong = a.ground.states ^ states
            require(not wrong, f"the boards lost the executor and drive {a.ground.states:b}; on_loss wants {states:b}")
        else:
            moved = (a.ground.states ^ states) & ~self.lets_go & ~off
            require(not moved, f"{moved:b} switched between two executors")
