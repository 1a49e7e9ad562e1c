"""The lines for the journal, and what systemd is told: each goal, refusal and fault once, and the watchdog in time."""

from __future__ import annotations

import logging
import math
from collections import deque
from collections.abc import Mapping

from tests.simulation.judge.interface.account import InterfaceAccount
from tests.simulation.judge.interface.facts import Payload
from tests.simulation.judge.verdict import require

MOST_LINES = 5  # refusals in one second
REMEMBERED = 20.0  # [s]
AGREE_WITHIN = 0.3  # [s], awake, between a state and the lines on its faults
WATCHDOG = 1.3, 0.9  # [s], awake, longest and shortest time between two
MANY = f"more than {MOST_LINES} requests are refused in this second"
UNTOLD = {"clock-set", "network-lost", "ledger-unwritten"}  # warnings, which the shell logs itself
WARNINGS = {  # of the executor's page
    *("bus-passive", "board-limits", "outputs-off", "ledger-damaged", "journal", "in-obstacle", "unknown-state"),
    *("unknown-position", "degraded"),
}
BY_GATEWAY = ("not-named", "busy", "unknown-goal")


class Journal:
    """Judges lines and notifications."""

    def __init__(self, account: InterfaceAccount) -> None:
        self._a = account
        self.begin()

    def begin(self) -> None:
        a = self._a
        self._lines: deque[tuple[float, str]] = deque(maxlen=300)
        self._faults: dict[tuple[str, str], float] = {}  # that lines tell, and since when, awake
        self._over: dict[tuple[str, str], float] = {}
        self._second, self._refusals = 0, 0
        self._statuses: deque[tuple[float, str]] = deque(maxlen=20)
        self._watchdog = a.awake

    def logs(self, level: int, text: str, fields: Mapping[str, str]) -> None:
        a = self._a
        self._lines.append((a.now, text))
        if "HYPERBIT_FAULT" in fields:
            self._take_fault(level, text, fields)
        elif "HYPERBIT_REASON" in fields or text == MANY:
            self._count_refusal(text)

    def _take_fault(self, level: int, text: str, fields: Mapping[str, str]) -> None:
        key = fields["HYPERBIT_FAULT"], fields["HYPERBIT_SOURCE"]
        if text == f"{key[0]} at {key[1]} is over":
            require(key in self._faults, f"the journal says that {key} is over, and not that it began")
            require(level == logging.INFO, f"the line {text} has the level {level}")
            del self._faults[key]
            self._over[key] = self._a.awake
            return
        require(key not in self._faults, f"the journal tells {key} again")
        wanted = logging.WARNING if key[0] in WARNINGS else logging.ERROR
        require(text.startswith(f"{key[0]}: ") and level == wanted, f"the line {text} has the level {level}")
        self._faults[key] = self._a.awake

    def _count_refusal(self, text: str) -> None:
        second = int(self._a.now)
        self._refusals = self._refusals + 1 if second == self._second else 1
        self._second = second
        require(self._refusals <= MOST_LINES + 1, f"the journal has {self._refusals} refusals in one second")
        require((text == MANY) == (self._refusals == MOST_LINES + 1), f"line {self._refusals} of a second is {text}")

    def refused(self, answer: Payload) -> None:
        """Judges that the journal has the refusal of a goal or jog."""
        goal, reason = answer.get("id"), answer.get("reason")
        if goal is None or reason in BY_GATEWAY or str(goal).startswith("plan"):
            return
        line = f"{goal} refused: {answer['message']}"
        known = any(text in (line, MANY) for at, text in self._lines if at >= self._a.now - REMEMBERED)
        late = self._a.quits or len(self._lines) == self._lines.maxlen
        require(known or late, f"the journal does not have the refusal {answer}")

    def result(self, payload: Payload) -> None:
        """Judges that the journal has a result."""
        line = f"goal {payload['id']} {payload['status']}: {payload['message']}"
        known = any(text == line for _, text in self._lines)
        require(known or len(self._lines) == self._lines.maxlen, f"the journal does not have the result {payload}")

    def state(self, payload: Payload) -> None:
        """Compares the faults of a state with the lines, and its mode and reason with the status for systemd."""
        awake = self._a.awake
        told = {(f["code"], f["source"]) for f in payload["faults"]} - {
            (f["code"], f["source"]) for f in payload["faults"] if f["code"] in UNTOLD
        }
        for key in told - self._faults.keys():
            over = awake - self._over.get(key, -math.inf)
            require(over < AGREE_WITHIN, f"state tells {key}, and the journal does not")
        for key in self._faults.keys() - told:
            since = awake - self._faults[key]
            require(since < AGREE_WITHIN, f"the journal tells {key} for {since:g} s, and state does not")
        boards = " (simulated)" if self._a.simulated else ""
        status = f"STATUS={payload['mode']}{boards}: {payload['reason']}"
        lately = [text for at, text in self._statuses if awake - at < AGREE_WITHIN]
        before = [text for at, text in self._statuses if awake - at >= AGREE_WITHIN]
        permitted = [*before[-1:], *lately]
        full = len(self._statuses) == self._statuses.maxlen
        require(status in permitted or full, f"systemd was told {permitted}, and state is {status}")

    def notifies(self, assignment: str) -> None:
        a = self._a
        if assignment.startswith("STATUS="):
            last = self._statuses[-1][1] if self._statuses else ""
            require(assignment != last, f"systemd is told {assignment} again")
            self._statuses.append((a.awake, assignment))
        elif assignment == "WATCHDOG=1":
            apart = a.awake - self._watchdog
            first = self._watchdog == a.began_awake
            fits = apart <= WATCHDOG[0] and (apart >= WATCHDOG[1] or first or a.had("still", a.now - 3.0))
            require(fits, f"the watchdog is fed {apart:g} s after the last time")
            self._watchdog = a.awake

    def tick(self) -> None:
        """Finds a watchdog that starves."""
        a = self._a
        if a.process and not a.quits:
            apart = a.awake - self._watchdog
            require(apart <= WATCHDOG[0], f"the watchdog was not fed for {apart:g} s")
