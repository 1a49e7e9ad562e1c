"""The warnings of the planner's process: the clock was set, the network is lost, the ledger cannot be written."""

from __future__ import annotations

import math
import re

from tests.simulation.judge.interface.account import InterfaceAccount
from tests.simulation.judge.interface.facts import Payload
from tests.simulation.judge.verdict import require

POLLED = 0.6  # [s], awake, from a cause to its warning: looked for four times a second, and the outbox
LASTS = 10.0  # [s] for which a warning stays after its cause
STEP = 0.5  # [s]; smaller jumps of the clock are no warning
LOST = re.compile(r"no peer was connected over Zenoh for ([\d.]+) s: the arm continued by itself")
SET = "the system's clock was set by {:+.1f} s: stamps follow it, motions do not"


class JudgedWarnings:
    """Judges warnings."""

    def __init__(self, account: InterfaceAccount) -> None:
        self._a = account
        self._sets: list[tuple[float, float, float]] = []  # time and awake time of each setting of the clock, and by
        self._lost, self._lost_at, self._found_at = False, math.inf, -math.inf
        self._waits, self._waits_at, self._written_at = False, math.inf, -math.inf  # records for the ledger

    def clock_set(self, by: float) -> None:
        """The wall clock is set by a time [s]."""
        self._sets = [*self._sets[-9:], (self._a.now, self._a.awake, by)]

    def network(self, lost: bool) -> None:
        """The connections to all peers are lost, or are back."""
        if lost != self._lost:
            self._lost = lost
            self._lost_at, self._found_at = (self._a.awake, self._found_at) if lost else (math.inf, self._a.awake)

    def ledger(self, waits: bool) -> None:
        """Records wait because the ledger cannot be written, or no longer."""
        if waits != self._waits:
            self._waits = waits
            self._waits_at, self._written_at = (self._a.awake, self._written_at) if waits else (math.inf, self._a.awake)

    # ---

    def state(self, payload: Payload) -> None:
        a = self._a
        told = {fault["code"]: fault["message"] for fault in payload["faults"]}
        held_up = a.lately("still", POLLED) or a.lately("congested", POLLED) or a.congested or a.slow
        mine = [(at, awake, by) for at, awake, by in self._sets if at > a.began_at]
        large = [entry for entry in mine if abs(entry[2]) > STEP]
        surely = any(a.awake - awake > POLLED and a.now - at < LASTS - POLLED for at, awake, by in large)
        surely = surely and sum(abs(by) > STEP for _, _, by in large) == 1
        perhaps = any(a.awake - awake < LASTS + 2 * POLLED for _, awake, _ in mine) or held_up
        text = f"state {payload['faults']}; the clock was set {self._sets}"
        require("clock-set" not in told or perhaps, text)
        require("clock-set" in told or not surely or held_up, text)
        if "clock-set" in told and len(mine) == 1:
            require(told["clock-set"] == SET.format(mine[0][2]), text)
        self._judge_network(told, held_up, f"state {payload['faults']}; lost: {self._lost}, {self._lost_at}")
        self.judge_ledger("ledger-unwritten" in told, f"state {payload['faults']}; records wait: {self._waits}")

    def _judge_network(self, told: dict[str, str], held_up: bool, text: str) -> None:
        a = self._a
        surely = self._lost and a.awake - max(self._lost_at, a.began_awake) > POLLED
        perhaps = self._lost or a.awake - self._found_at < LASTS + 2 * POLLED or held_up
        require("network-lost" not in told or perhaps, text)
        require("network-lost" in told or not surely or held_up, text)
        if "network-lost" in told:
            match = LOST.fullmatch(told["network-lost"])
            require(match is not None, text)
            if match is not None and surely and not held_up:
                least = a.awake - max(self._lost_at, a.began_awake) - POLLED
                require(least - 0.1 <= float(match[1]), text)

    def judge_ledger(self, told: bool, text: str) -> None:
        """Judges whether somebody is told that the ledger cannot be written."""
        a = self._a
        surely = self._waits and a.awake - max(self._waits_at, a.began_awake) > POLLED
        perhaps = self._waits or a.awake - self._written_at < POLLED + 0.2
        held_up = a.slow or a.congested or a.lately("congested", POLLED) or a.lately("still", POLLED)
        require(told or not surely or held_up, text)
        require(not told or perhaps or held_up, text)
