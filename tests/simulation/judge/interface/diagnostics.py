"""`diagnostics`: the executor's last report, the counts of the planner, and the states of both in words."""

from __future__ import annotations

from collections import deque

from hyperbit.controller.program import Diagnostics
from tests.simulation.judge.interface.account import InterfaceAccount
from tests.simulation.judge.interface.facts import Payload
from tests.simulation.judge.interface.warnings import JudgedWarnings
from tests.simulation.judge.verdict import require

EVERY, LEAST = 1.3, 0.9  # [s], awake, longest and shortest time between two
DELAY = 0.1  # [s], awake, from a report of the executor to its publication
STAMPED_WITHIN = 0.03  # [s]


class JudgedDiagnostics:
    """Judges `diagnostics`.

    Attributes:
        tasks: least and greatest number of tasks of the workers since the last publication.
    """

    def __init__(self, account: InterfaceAccount, warnings: JudgedWarnings) -> None:
        self._a, self._warnings, self.tasks = account, warnings, (0, 0)
        self.begin()

    def begin(self) -> None:
        self._told = self._a.awake
        self._reports: deque[tuple[float, Diagnostics | None]] = deque([(self._a.awake, None)], maxlen=20)
        self._counts: list[int] = []
        self._first = True

    def hears(self, report: Diagnostics | None) -> None:
        """The planner gets a report, or loses the executor."""
        self._reports.append((self._a.awake, report))

    def diagnostics(self, payload: Payload) -> None:
        a = self._a
        apart = a.awake - self._told
        stood = a.lately("still", 2 * EVERY) or a.lately("congested", 3.0) or a.congested or a.slow
        soon = self._first or stood or apart >= LEAST
        require(soon, f"diagnostics come {apart:g} s after the last")
        self._told, self._first = a.awake, False
        whys = [self._differs(payload, report) for report in self._latest()]
        require("" in whys, f"diagnostics {payload}: {whys}")
        self._judge_counts(payload)
        queues = payload["queues"]
        waiting = [r for r in a.requests if r.key in ("goal", "jog", "plan") and r.answered_at > a.now - 1.0]
        surely = [r for r in waiting if r.key == "plan" and r.query and r.answer is None and r.awake < a.awake - 0.2]
        least = 0 if stood else len(surely)
        planning = queues["planning"]
        require(least <= planning <= len(waiting), f"diagnostics {queues}, {least} to {len(waiting)} requests wait")
        least, most = self.tasks
        require(
            stood or least <= queues["inbox"] <= most, f"diagnostics {queues}; workers have {least} to {most} tasks"
        )
        require(queues["outbox"] >= 0, f"diagnostics {queues}")

    def _latest(self) -> list[Diagnostics | None]:
        """Returns the reports that may be the last one."""
        since, found = self._a.awake - DELAY - 0.5 * self._a.slow, list[Diagnostics | None]()
        for awake, report in reversed(self._reports):
            found.append(report)
            if awake < since:
                break
        return found

    def _differs(self, payload: Payload, report: Diagnostics | None) -> str:
        """Returns in which field a publication differs from a report; "" if in none."""
        a = self._a
        if report is None:
            empty = {"loop": {}, "buses": [], "boards": [], "counts": [], "waits": 0, "dropped": 0, "real_time": "off"}
            wrong = [name for name, value in empty.items() if payload[name] != value]
            return f"{wrong} without an executor" if wrong or payload["executor"] == "connected" else ""
        told = {
            "loop": report.loop,
            "buses": report.buses,
            "boards": report.boards,
            "counts": list(report.counts),
            "waits": report.waits,
            "dropped": report.dropped,
            "real_time": report.real_time,
            "executor": "connected",
        }
        wrong = [name for name, value in told.items() if payload[name] != value]
        if wrong:
            return f"{wrong} differ"
        age = a.wall() - payload["stamp"] - (a.now - report.at)
        unsure = a.lately("clock", DELAY) or a.lately("still", DELAY) or a.congested or a.lately("congested", 1.0)
        return "" if abs(age) <= STAMPED_WITHIN or unsure else f"the stamp is {age:g} s off"

    def _judge_counts(self, payload: Payload) -> None:
        a, counts = self._a, list(payload["counts"])
        if counts and self._counts:
            fell = [k for k, (now, before) in enumerate(zip(counts, self._counts, strict=True)) if now < before]
            require(not fell, f"diagnostics count {counts} after {self._counts}")
        self._counts = counts or self._counts
        if a.counts_at_start is not None:
            switches = max(sum(counts) - a.counts_at_start, 0)
            require(payload["switches"] == switches, f"diagnostics tell {payload['switches']} switches, not {switches}")
        self._warnings.judge_ledger(payload["ledger"] != "ok", f"diagnostics tell the ledger {payload['ledger']}")

    def tick(self) -> None:
        """Finds diagnostics that do not come."""
        a = self._a
        if a.process and a.now - a.began_at > 0.5 and not a.quits:
            late = a.awake - self._told
            require(late <= EVERY, f"no diagnostics for {late:g} s")
