"""Proofs: which switches of actuators without end-stops the executor may call done, because it has read them back."""

from __future__ import annotations

import math
from collections import Counter
from typing import Any

from tests.simulation.judge.account import Account, Commit, Run
from tests.simulation.judge.arm import bits_of, mask_of, merged
from tests.simulation.judge.verdict import require

RPDOS = range(0x200, 0x600, 0x100)
SDO_REQUEST, SDO_ANSWER = 0x600, 0x580
READ = 0x40  # command of a request to read
EXPEDITED = 0xE3  # mask of the command of an answer of at most four bytes


class Proofs:
    """Judges what was read back before a goal is done.

    Attributes:
        missed: mask of the actuators whose last pulse was over before it was read; it may be given again.
        doubted: mask of those that may be given again, too: an answer may have belonged to an earlier request.
        states: states of the last pulses.
        heard_at: when the process heard that a SYNC was sent [s].
    """

    def __init__(self, account: Account, arm: Any) -> None:
        self._a = account
        nodes = {(node.bus, node.node): node for node in arm.wiring.nodes}
        self._base = {place: node.object for place, node in nodes.items()}
        self._channels = arm.wiring.channels
        forgone = mask_of(k for k, c in enumerate(self._channels) if (n := nodes.get((c.bus, c.node))) and not n.verify)
        self._blind = account.arm.everything & ~account.arm.sensed & ~forgone
        self.forgone = forgone & ~account.arm.sensed
        self.begin()

    def begin(self) -> None:
        self._ready_at = math.inf  # end of the last boot [s]
        self.missed = self.doubted = self.states = self._open = self._late = 0
        self.heard_at = -math.inf
        self._on: tuple[int, int] | None = None  # commanded last: extending outputs, contracting outputs of pairs
        self._known_at = [0.0] * self._a.arm.count  # when the process heard of each actuator's SYNC [s]
        self._asked: dict[tuple[str, int, int], float] = {}  # last request for each byte of outputs [s]
        self._unanswered: Counter[tuple[str, int, int]] = Counter()  # number of these requests

    @property
    def unread(self) -> int:
        """Mask of the actuators without end-stops that were switched, and that nobody has read since."""
        return self._open | self.missed

    def switched(self, commit: Commit, here: int) -> None:
        """The process hears that the SYNC of a commit was sent to the boards of the actuators of a mask."""
        self.heard_at = self._a.now
        a, paired, here = self._a, self._a.arm.paired, here & commit.mask
        extends, contracts = self._on or (0, 0)
        self._on = merged(here, commit.extends, extends), merged(here, commit.contracts_to & paired, contracts)
        over = (extends & ~self._on[0] | contracts & ~self._on[1]) & paired
        came = self._on[0] & ~extends | self._on[1] & ~contracts | extends & ~self._on[0] & ~paired
        self.missed = (self.missed | over & mask_of(a.arm.pulse) & self._open & self._blind) & ~came
        self.doubted = (self.doubted | over & mask_of(a.arm.pulse) & self._late) & ~came
        self._open, self._late = (self._open & ~over | came) & self._blind, self._late & ~over & ~came
        self.states = merged(came, self._on[0], self.states)
        for k in bits_of(came):
            self._known_at[k] = a.now
        if a.run is not None:
            a.run.moved |= came

    def hands_out(self, bus: str, cob_id: int, data: bytes) -> None:
        """Takes a frame of the process. A boot reads all outputs."""
        if self._a.ready_at != self._ready_at:
            self.begin()
            self._ready_at = self._a.ready_at
        if self._on is None and cob_id & 0x780 in RPDOS:
            ground, paired = self._a.ground, self._a.arm.paired
            self._on = ground.states & (ground.on | ~paired), ~ground.states & ground.on
        if cob_id & 0x780 == SDO_REQUEST and data[0] == READ:
            index, sub = int.from_bytes(data[1:3], "little"), data[3]
            if index == self._base.get((bus, cob_id & 0x7F), 0x6200):
                self._asked[bus, cob_id & 0x7F, sub] = self._a.now
                self._unanswered[bus, cob_id & 0x7F, sub] += 1

    def hears(self, bus: str, cob_id: int, data: bytes) -> None:
        if cob_id & 0x780 != SDO_ANSWER or len(data) != 8 or data[0] & EXPEDITED != 0x43 & EXPEDITED:
            return
        index, sub, node = int.from_bytes(data[1:3], "little"), data[3], cob_id & 0x7F
        asked = self._asked.get((bus, node, sub))
        if index != self._base.get((bus, node), 0x6200) or asked is None:
            return
        self._unanswered[bus, node, sub] -= 1
        for k in bits_of(self._open):
            channel = self._channels[k]
            state = self.states >> k & 1
            second = channel.output_off is not None and not state
            bit, name = (channel.output_off, "output_off") if second else (channel.output, "output")
            level = (state if channel.output_off is None else 1) != (name in channel.inverted)
            here = (channel.bus, channel.node, 1 + bit // 8) == (bus, node, sub)
            if here and asked >= self._known_at[k] and data[4] >> bit % 8 & 1 == level:
                self._open &= ~(1 << k)
                self._late |= (self._unanswered[bus, node, sub] > 0) << k

    def done(self, run: Run, verified: bool, text: str) -> None:
        wrong = run.moved & self.unread
        require(not wrong, f"{text} is done, and nobody has read back the outputs of {wrong:b}")
        told = verified == (not run.moved & self.forgone)
        require(told, f"{text} tells verified as {verified}, {run.moved:b} has moved, nobody reads {self.forgone:b}")
