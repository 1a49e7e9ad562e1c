"""State and diagnostics: the latest, with warnings, and notifications to systemd."""

import json
import logging
import socket
import tempfile
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest

from controller.gateway.status_reporter import StatusReporter
from controller.notify import Notifier
from controller.planning.core.messages import Payload
from controller.program import Fault
from tests.gateway.test_outbox import FakeSession
from tests.waiting import PATIENCE, eventually

STUCK = {"code": "stuck", "source": "1.left", "message": "it reads contracted"}


class Bench:
    """A reporter of a state that tests change."""

    def __init__(self, stack: ExitStack) -> None:
        self._stack, self.session, self.changed = stack, FakeSession(), threading.Event()
        self.state: Payload | Exception = {"mode": "ready", "reason": "holding", "faults": [STUCK]}
        self.warnings: tuple[Fault, ...] = ()

    def report(self) -> StatusReporter:
        def state() -> Payload:
            if isinstance(self.state, Exception):
                raise self.state
            return self.state

        reporter = StatusReporter(
            self.session, "p", state, lambda: {"queues": {"planning": 2}}, self.changed, lambda: self.warnings,
            lambda: 7, Notifier(),
        )  # fmt: skip
        self._stack.callback(reporter.close, PATIENCE)
        return reporter

    def heard(self, key: str) -> list[Any]:
        return [payload for name, payload in self.session.sent if name == f"p/{key}"]


@pytest.fixture
def bench() -> Iterator[Bench]:
    with ExitStack() as stack:
        bench = Bench(stack)
        stack.callback(bench.session.taking.set)
        yield bench


def test_warnings_are_added_to_the_faults_once(bench: Bench) -> None:
    bench.warnings = (Fault("stuck", "1.left", "said twice"), Fault("ledger-unwritten", "ledger", "the disk is full"))
    bench.report()
    state = eventually(lambda: bench.heard("state"))[0]
    unwritten = {"code": "ledger-unwritten", "source": "ledger", "message": "the disk is full"}
    assert state["faults"] == [STUCK, unwritten]


def test_faults_are_written_into_the_journal_once_with_their_fields(
    bench: Bench, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.INFO)
    lost = {"code": "board-lost", "source": "can0/3", "message": "no heartbeat"}
    bench.state = {"mode": "fault", "reason": "a board is lost", "faults": [lost]}
    bench.warnings = (Fault("clock-set", "clock", "the clock was set"),)
    bench.report()
    eventually(lambda: len(bench.heard("state")) > 2)
    bench.state = {"mode": "ready", "reason": "holding", "faults": []}
    eventually(lambda: len(caplog.records) == 2)
    (begun, over) = caplog.records
    assert (begun.levelname, begun.getMessage()) == ("ERROR", "board-lost: no heartbeat")
    assert (over.levelname, over.getMessage()) == ("INFO", "board-lost at can0/3 is over")
    for record in (begun, over):
        assert record.journal["HYPERBIT_BOARD"] == "3"  # type: ignore[attr-defined]
    assert begun.journal["MESSAGE_ID"] != over.journal["MESSAGE_ID"]  # type: ignore[attr-defined]


def test_diagnostics_have_the_outbox_beside_the_queues_of_the_planner(bench: Bench) -> None:
    bench.report()
    eventually(lambda: bench.heard("diagnostics"))
    assert bench.heard("diagnostics")[0] == {"queues": {"planning": 2, "outbox": 7}}


def test_states_come_without_a_change_and_the_last_one_at_the_end(bench: Bench) -> None:
    reporter = bench.report()
    eventually(lambda: len(bench.heard("state")) > 3)
    bench.state = {"mode": "ready", "reason": "the last", "faults": []}
    reporter.close(PATIENCE)
    assert bench.heard("state")[-1]["reason"] == "the last"


def test_for_a_slow_peer_only_the_latest_state_waits(bench: Bench) -> None:
    bench.session.taking.clear()
    reporter = bench.report()
    assert bench.session.waiting.wait(PATIENCE)
    for k in range(100):
        bench.state = {"mode": "ready", "reason": str(k), "faults": []}
        bench.changed.set()
    closing = threading.Thread(target=reporter.close, args=(PATIENCE,))
    closing.start()
    bench.session.taking.set()
    closing.join(PATIENCE)
    reasons = [state["reason"] for state in bench.heard("state")]
    assert (reasons[0], reasons[-1]) == ("holding", "99")
    assert len(reasons) <= 3


@pytest.mark.parametrize("defect", [RuntimeError("a defect"), {"mode": "\udc80", "faults": []}])
def test_it_survives_a_state_that_cannot_be_published(bench: Bench, defect: Any) -> None:
    bench.state, good = defect, bench.state
    bench.report()
    eventually(lambda: bench.heard("diagnostics"))
    bench.state = good
    assert eventually(lambda: bench.heard("state"))[0]["mode"] == "ready"


@pytest.fixture
def systemd(monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[[], str]]:
    """A socket in place of systemd's; receives one message."""
    with tempfile.TemporaryDirectory() as folder, socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as receiver:
        receiver.bind(path := str(Path(folder) / "notify"))
        receiver.settimeout(PATIENCE)
        monkeypatch.setenv("NOTIFY_SOCKET", path)
        yield lambda: receiver.recv(10_000).decode()


def test_systemd_is_told_the_mode_when_it_changes_and_fed_its_watchdog(
    bench: Bench, systemd: Callable[[], str]
) -> None:
    bench.state = {"mode": "ready", "reason": "holding\nFDSTORE=1", "faults": []}
    bench.report()
    assert systemd() == "STATUS=ready: holding FDSTORE=1"
    assert systemd() == "WATCHDOG=1"
    bench.state = {"mode": "fault", "reason": "a board is lost", "faults": []}
    bench.changed.set()
    while (word := systemd()) == "WATCHDOG=1":
        pass
    assert word == "STATUS=fault: a board is lost"


def test_without_systemd_nothing_is_sent(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("NOTIFY_SOCKET", "")
    Notifier().send("READY=1")


def test_json_is_published(bench: Bench) -> None:
    bench.report()
    assert json.dumps(eventually(lambda: bench.heard("state"))[0])
