"""What becomes of the actuators at the end and the loss of the executor."""

from __future__ import annotations

from typing import Any

from tests.simulation.judge.account import Account
from tests.simulation.judge.arm import mask_of, merged
from tests.simulation.judge.verdict import require

LOST_LATE = 0.03  # [s] after `heartbeat_timeout` until a board acts on the loss of its master: its clock rounds


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
