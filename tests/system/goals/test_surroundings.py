"""The arm's surroundings fail: the system's clock, the ledger's disk, Zenoh's router. The arm continues."""

import itertools
import sqlite3
import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest
import zenoh

from hyperbit.controller.host.keeper import write_whole
from hyperbit.controller.network import session
from hyperbit.controller.planning.ledger_file import read
from tests.system.stack.lives import Lives
from tests.system.stack.observer import Observer
from tests.system.stack.places import HOUR, LEFT, MIDDLE, RIGHT
from tests.system.stack.system import System
from tests.waiting import SLOWNESS, eventually

pytestmark = pytest.mark.buses("virtual")


def written(ledger: Path) -> tuple[dict[str, int], list[dict[str, Any]]]:
    """The content of the ledger, which may not exist yet."""
    try:
        return read(ledger)
    except sqlite3.Error:
        return {}, []


@pytest.fixture
def clock(system: System) -> Callable[[float], float]:
    """Sets the clock of planners that start now by some seconds; the executor does not use the time of day."""
    system.clock = file = system.folder / "clock"

    def put(ahead: float) -> float:
        write_whole(file, str(ahead).encode(), sync=False)
        return ahead

    put(0.0)
    return put


@pytest.mark.fresh
def test_a_clock_that_is_set_moves_nothing_and_ends_no_goal(clock: Callable[[float], float], lives: Lives) -> None:
    """Takes 9 s: goals of 3 s before and after each change of the clock."""
    client, ahead = lives.client, 0.0
    for number, hours in enumerate((1, -1)):
        client.move(MIDDLE, goal=f"before {number}")
        stamp = time.time() + ahead + SLOWNESS
        answer = client.goal(RIGHT, LEFT, MIDDLE, times=[0.0, 1.0, 2.0], stamp=stamp, id=f"a{number}")
        assert answer["accepted"], answer
        eventually(lambda number=number: client.feedback(f"a{number}"))
        began, since = time.monotonic(), len(client.heard["state"])
        ahead = clock(hours * HOUR)
        eventually(lambda since=since: any("clock-set" in str(it["faults"]) for it in client.heard["state"][since:]))
        assert client.result(f"a{number}")["status"] == "succeeded"
        assert time.monotonic() - began < HOUR / 2, "the other waypoints come by the steady clock"
        state = client.wait_now("ready")
        assert abs(state["stamp"] - time.time() - ahead) < HOUR / 2, "stamps go with the clock"
        stamp = time.time() + ahead + 0.5 * SLOWNESS
        assert client.goal(RIGHT, stamp=stamp, id=f"b{number}")["accepted"], "and so do goals"
        assert client.result(f"b{number}")["status"] == "succeeded"
    lives.check()
    assert lives.motions.switched.sum() == sum(result["switches"] for result in client.heard["result"])


def told(client: Observer, code: str) -> str:
    return next(fault["message"] for fault in client.state["faults"] if fault["code"] == code)


@pytest.fixture
def disk(system: System) -> Iterator[Path]:
    folder = system.folder / "disk"
    folder.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", "size=512k", "tmpfs", str(folder)]
    done = subprocess.run(mount, capture_output=True, text=True)
    if done.returncode != 0:
        pytest.skip(f"a full disk needs a disk of its own, and none can be mounted here: {done.stderr.strip()}")
    system.ledger = folder / "ledger.sqlite"
    yield folder
    system.end_planner()
    subprocess.run(["umount", "--lazy", str(folder)], check=True)


@pytest.mark.fresh
def test_a_full_disk_is_told_and_the_arm_goes_on(system: System, disk: Path) -> None:
    system.start()
    with system.client() as client:
        client.move(MIDDLE, goal="before")
        eventually(lambda: written(system.ledger)[0])
        with (disk / "filler").open("wb", buffering=0) as filler, suppress(OSError):
            while True:
                filler.write(bytes(1024))
        for number in itertools.count():  # goals with long names until the disk is full
            goal = f"{number} {'x' * 120}"
            client.move((LEFT, RIGHT)[number % 2], goal=goal)
            if "ledger-unwritten" in client.codes:
                break
        assert "full" in told(client, "ledger-unwritten")
        assert client.wait_now("ready")["goal"] is None
        (disk / "filler").unlink()
        eventually(lambda: not client.codes)
        eventually(lambda: system.counts() == system.boards.switches().tolist())


@pytest.mark.fresh
@pytest.mark.parametrize("damaged", ["*.sqlite*", "*.switches"])
def test_of_ledger_and_journal_one_may_be_damaged_and_no_switch_is_forgotten(system: System, damaged: str) -> None:
    system.start()
    with system.client() as client:
        client.move(RIGHT, goal="before")
        eventually(lambda: system.counts() == system.boards.switches().tolist())
    system.end_planner()
    system.executor.end()
    for part in system.folder.glob(damaged):
        part.write_bytes(b"\x5a" * part.stat().st_size)
    system.start()
    with system.client() as client:
        client.move(LEFT, goal="after")
        if damaged == "*.switches":
            assert "was damaged" in (system.folder / "executor.log").read_text()
        else:
            eventually(lambda: "ledger-damaged" in client.codes)
            assert "a new one was begun" in told(client, "ledger-damaged")
        assert client.wait_now("ready")["goal"] is None
        eventually(lambda: system.counts() == system.boards.switches().tolist())


@pytest.mark.fresh
def test_a_router_that_goes_and_comes_back_is_found_again_and_the_goal_goes_on(
    system: System, caplog: pytest.LogCaptureFixture
) -> None:
    """Daemon and client meet at a router only; a goal that ends while the router is away is in the ledger."""
    listening = session.configuration("peer", listen=system.endpoint)
    system.config = system.clients()
    with zenoh.open(listening):
        system.start()
        with system.client() as client:
            assert client.goal(MIDDLE, RIGHT, times=[0.0, 1.0], id="a")["accepted"]
    eventually(lambda: any(goal["status"] == "succeeded" for goal in written(system.ledger)[1]))
    assert system.boards.switches().sum() > 0
    with zenoh.open(listening):
        with system.client() as later:
            later.wait_for("ready")
            assert any("network-lost" in record.getMessage() for record in caplog.records), "nobody else hears it"
            assert "network-lost" in [fault["code"] for fault in later.heard["state"][0]["faults"]]
            later.move(LEFT, goal="b")
        system.end_planner()
