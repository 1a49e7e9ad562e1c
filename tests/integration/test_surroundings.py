"""What is around the arm fails: the system's clock, the ledger's disk, Zenoh's routers and readers. It goes on."""

import itertools
import sqlite3
import subprocess
import threading
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest
import zenoh

from controller.daemon import session
from controller.daemon.client import Client
from controller.daemon.ledger import read
from drivers.simulation.simulation import Simulation
from tests.daemon.waiting import SLOWNESS, eventually
from tests.integration.conftest import Bench
from tests.integration.harness import Observer
from tests.integration.motions import Motions
from tests.integration.test_goals import HOUR, LEFT, MIDDLE, RIGHT

SYNC = 0x080


def written(bench: Bench) -> tuple[dict[str, int], list[dict[str, Any]]]:
    """What is in the ledger, which may not be there yet."""
    try:
        return read(bench.ledger)
    except sqlite3.Error:
        return {}, []


@pytest.mark.parametrize("hours", [1, -1])
def test_a_clock_that_is_set_moves_nothing_and_ends_no_goal(
    client: Observer, motions: Motions, monkeypatch: pytest.MonkeyPatch, hours: int
) -> None:
    client.move(MIDDLE, goal="before")
    stamp = time.time() + 1.0
    assert client.goal(RIGHT, LEFT, MIDDLE, times=[0.0, 1.0, 2.0], stamp=stamp, id="a")["accepted"]
    eventually(lambda: client.feedback("a"))
    began, real = time.monotonic(), time.time
    monkeypatch.setattr(time, "time", lambda: real() + hours * HOUR)
    state = client.wait_fault("clock-set", time.time(), within=1.0)
    assert state["mode"] == "executing"
    assert client.result("a")["status"] == "succeeded"
    assert 0.5 < time.monotonic() - began < 20, "two more waypoints, a second apart"
    state = client.wait_now("ready")
    assert abs(state["stamp"] - time.time()) < 60, "stamps go with the clock"
    stamp = time.time() + 0.5
    assert client.goal(RIGHT, stamp=stamp, id="b")["accepted"], "and so do goals"
    assert client.result("b")["status"] == "succeeded"
    monkeypatch.undo()
    motions.read()
    motions.moved_at.clear()  # told by the clock that was set


@pytest.fixture
def disk(tmp_path: Path) -> Iterator[Path]:
    """A small disk."""
    folder = tmp_path / "disk"
    folder.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", "size=512k", "tmpfs", str(folder)]
    done = subprocess.run(mount, capture_output=True, text=True)
    if done.returncode != 0:
        pytest.skip(f"a full disk needs a disk of its own, and none can be mounted here: {done.stderr.strip()}")
    yield folder
    subprocess.run(["umount", "--lazy", str(folder)], check=True)


@pytest.fixture
def bench_on_disk(disk: Path, bench: Bench) -> Bench:
    """A daemon of it has its ledger on the small disk; to be asked for before the client."""
    bench.ledger = disk / "ledger.sqlite"
    return bench


def test_a_full_disk_is_told_and_the_arm_goes_on(
    bench_on_disk: Bench, disk: Path, client: Observer, motions: Motions
) -> None:
    def unwritten() -> bool:
        return any(fault["code"] == "ledger-unwritten" for fault in client.heard["state"][-1]["faults"])

    client.move(MIDDLE, goal="before")
    eventually(lambda: written(bench_on_disk)[0])
    with (disk / "filler").open("wb", buffering=0) as filler, suppress(OSError):
        while True:
            filler.write(bytes(1024))
    for number in itertools.count():  # goals of long names until the file has no room for them
        goal = f"{number} {'x' * 120}"
        client.move((LEFT, RIGHT)[number % 2], goal=goal)
        eventually(lambda goal=goal: unwritten() or goal in [it["id"] for it in written(bench_on_disk)[1]])
        if unwritten():
            break
    state = client.wait_fault("ledger-unwritten", client.times["result"][-1], within=1.0)
    assert state["mode"] == "ready"
    assert "full" in next(fault["message"] for fault in state["faults"])
    (disk / "filler").unlink()
    eventually(lambda: not client.heard["state"][-1]["faults"])
    eventually(lambda: sum(written(bench_on_disk)[0].values()) == sum(it["switches"] for it in client.heard["result"]))


def test_a_damaged_ledger_is_moved_aside_and_no_switch_is_forgotten(
    client: Observer, bench: Bench, motions: Motions
) -> None:
    client.move(RIGHT, goal="before")
    eventually(lambda: written(bench)[0])
    for part in bench.ledger.parent.glob(f"{bench.ledger.name}*"):
        if not part.name.endswith("-tally"):
            part.write_bytes(b"\x5a" * part.stat().st_size)
    client.move(LEFT, goal="after")
    state = client.wait_fault("ledger-damaged", client.times["result"][-1], within=1.0)
    assert state["mode"] == "ready"
    assert "a new one was begun" in state["faults"][0]["message"]
    eventually(lambda: written(bench)[0])
    assert sum(written(bench)[0].values()) == sum(result["switches"] for result in client.heard["result"])


def test_a_router_that_goes_and_comes_back_is_found_again_and_the_goal_goes_on(
    bench: Bench, boards: Simulation, endpoint: str, caplog: pytest.LogCaptureFixture
) -> None:
    """Daemon and client meet at a router only; a goal that ends while it is away is told in the ledger."""
    bench.mode = "client"
    router = zenoh.open(session.configuration("peer", listen=endpoint))
    bench.run()
    client = bench.observer()
    client.wait_for("ready")
    assert client.goal(MIDDLE, RIGHT, times=[0.0, 1.0], id="a")["accepted"]
    router.close()
    gone = time.time()
    eventually(lambda: any(g["status"] == "succeeded" for g in written(bench)[1]))
    assert boards.switches().sum() > 0
    again = zenoh.open(session.configuration("peer", listen=endpoint))
    bench.stack.callback(again.close)
    later = bench.observer()
    later.wait_for("ready")
    told = next(record for record in caplog.records if "network-lost" in record.getMessage())
    assert told.created - gone < 1.0 * SLOWNESS, "in the journal, as nobody else hears it"
    assert [fault["code"] for fault in later.heard["state"][0]["faults"]] == ["network-lost"], "for who comes back"
    later.move(LEFT, goal="b")
    assert [goal["status"] for goal in written(bench)[1]].count("succeeded") >= 1


def test_a_slow_reader_of_everything_delays_nobody(client: Observer, bench: Bench, motions: Motions) -> None:
    ending = threading.Event()
    slow = Client(bench.session(), "planar16")
    for key in ("state", "feedback", "result", "diagnostics"):
        slow.subscribe(key, lambda message: ending.wait(0.5))
    try:
        for k in range(8):
            client.move((LEFT, RIGHT)[k % 2], goal=f"goal {k}")
        begun = len(client.heard["diagnostics"])
        eventually(lambda: len(client.heard["diagnostics"]) > begun + 1)
        assert client.heard["diagnostics"][-1]["queues"]["outbox"] < 100
        assert client.heard["diagnostics"][-1]["loop"]["longest_work"] < 1.0
        assert client.wait_now("ready")["faults"] == []
    finally:
        ending.set()
