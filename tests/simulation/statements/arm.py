"""What the arm's file says about its actuators, as the judge reads it. Actuator k is bit k of masks and states."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any


def mask_of(actuators: Iterable[int]) -> int:
    return sum(1 << k for k in actuators)


def bits_of(mask: int) -> list[int]:
    return [k for k in range(mask.bit_length()) if mask >> k & 1]


def merged(mask: int, ones: int, zeros: int) -> int:
    """Returns the bits of `ones` where `mask` is 1, else those of `zeros`."""
    return ones & mask | zeros & ~mask


class JudgedArm:
    """Outputs, end-stops and times of A actuators.

    Attributes:
        paired: mask of those with two outputs.
        pulse: length of the pulse by actuator [s].
        extended_ends: mask of those with an end-stop at the extended end.
        contracted_ends: mask of those with one at the contracted end.
        sensed: mask of those with an end-stop.
        forgone: mask of those without one whose outputs are not read back, either (`verify: false`).
        travel: longest times to contracted and to extended, shape (A, 2) [s].
        margin: settle margins, shape (A,) [s].
        board_of: name of the board with the outputs, shape (A,).
        most: actuators that may switch at once.
        rest: rest time [s].
        limited: whether the inrush limit makes each stage wait for the stage before.
        planner_timeout: silence after which the planner is lost [s].
        declared: mask and states of the actuators that the file declares stuck.
        contracts_at_end: whether `on_stop` is contract.
    """

    def __init__(self, arm: Any) -> None:
        channels, timing = arm.wiring.channels, arm.timing
        self.count = len(channels)
        self.everything = (1 << self.count) - 1
        indexed = list(enumerate(channels))
        self.paired = mask_of(k for k, c in indexed if c.output_off is not None)
        self.pulse = {k: c.pulse for k, c in indexed if c.pulse is not None}
        self._ends = [mask_of(k for k, c in indexed if c.line(end)) for end in ("input", "input_contracted")]
        unread = {(node.bus, node.node) for node in arm.wiring.nodes if not node.verify}
        self._unread = mask_of(k for k, c in indexed if (c.bus, c.node) in unread)
        self.believe(True)
        both = timing.travel_time, timing.travel_time
        self.travel = [both if c.travel is None else c.travel for c in channels]
        self.margin = [timing.settle_margin if c.settle_margin is None else c.settle_margin for c in channels]
        self.board_of = [f"{c.bus}/{c.node}" for c in channels]
        self.bus_of = [c.bus for c in channels]
        self.labels = [c.actuator for c in channels]
        self.most = self.count if arm.inrush is None else arm.inrush
        self.limited, self.rest = arm.inrush is not None, arm.rest
        self.timing, self.planner_timeout = timing, arm.planner_timeout
        self.declared = arm.locked, arm.locked_states & arm.locked
        self.contracts_at_end = arm.contract_on_stop

    def believe(self, ends: bool) -> None:
        """Takes end-stops as what they are, or the arm as one without any: it is commissioned."""
        self.extended_ends, self.contracted_ends = self._ends if ends else (0, 0)
        self.sensed = self.extended_ends | self.contracted_ends
        self.forgone = self._unread & ~self.sensed

    def measured(self, extended: int, contracted: int, commanded: int) -> int:
        """Returns what end-stops tell: each end-stop reads 1 only at its end; else the commanded state."""
        both = self.extended_ends & self.contracted_ends
        silent = both & ~(extended ^ contracted)
        reads = merged(self.extended_ends, extended, ~contracted)
        return merged(self.sensed & ~silent, reads, commanded) & self.everything

    def definite(self, extended: int, contracted: int) -> int:
        """Returns the mask of the actuators whose end-stops tell a state."""
        both = self.extended_ends & self.contracted_ends
        return self.sensed & ~(both & ~(extended ^ contracted))
