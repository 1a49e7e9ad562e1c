"""The ledger: exact counts and results, through everything that can happen to file and process."""

import signal
import sqlite3
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from controller.daemon import ledger as module
from controller.daemon.ledger import Ledger, default_path, read
from tests.daemon.waiting import eventually

NAMES = ("1.left", "1.diagonal", "1.right")


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "state" / "arm.sqlite"


@pytest.fixture
def ledger(path: Path) -> Iterator[Ledger]:
    ledger = Ledger(path, NAMES)
    yield ledger
    ledger.close()


def switch(ledger: Ledger, *actuators: int) -> None:
    """A stage that switches these actuators, as a SYNC has it."""
    before, after = np.zeros(3, np.uint8), np.zeros(3, np.uint8)
    after[list(actuators)] = 1
    ledger.intend(before, after)
    assert ledger.resolve(after).tolist() == sorted(actuators)


def written(path: Path) -> tuple[dict[str, int], list[dict[str, Any]]]:
    """What is in the file, which may not be there yet."""
    try:
        return read(path)
    except sqlite3.Error:
        return {}, []


def test_switches_are_counted_exactly(ledger: Ledger, path: Path) -> None:
    for _ in range(1000):
        switch(ledger, 0, 2)
    switch(ledger, 2)
    switch(ledger)
    ledger.close()
    assert read(path)[0] == {"1.left": 1000, "1.right": 1001}


def test_goals_have_their_results(ledger: Ledger, path: Path) -> None:
    ledger.accepted(1, "a", 3)
    ledger.ended(1, "succeeded", 0, "reached", 12)
    ledger.accepted(2, "a", 1)
    ledger.ended(2, "aborted", -4, "stuck", 1)
    ledger.accepted(3, "b", 1)
    ledger.close()
    goals = read(path)[1]
    assert [(g["id"], g["waypoints"], g["status"], g["code"], g["message"], g["switches"]) for g in goals] == [
        ("b", 1, None, None, None, None),
        ("a", 1, "aborted", -4, "stuck", 1),
        ("a", 3, "succeeded", 0, "reached", 12),
    ]
    assert goals[1]["ended"] >= goals[1]["accepted"] > 1.7e9


def test_a_result_written_later_than_its_goal_finds_it(ledger: Ledger, path: Path) -> None:
    ledger.accepted(1, "a", 1)
    eventually(lambda: written(path)[1])
    ledger.ended(1, "succeeded", 0, "reached", 2)
    ledger.close()
    assert [goal["status"] for goal in read(path)[1]] == ["succeeded"]


def test_it_goes_on_where_it_was(ledger: Ledger, path: Path) -> None:
    switch(ledger, 0, 1)
    ledger.accepted(1, "a", 1)
    ledger.close()
    again = Ledger(path, NAMES)
    switch(again, 1)
    again.accepted(1, "b", 1)
    again.ended(1, "canceled", -1, "canceled", 0)
    again.close()
    switches, goals = read(path)
    assert switches == {"1.left": 1, "1.diagonal": 2}
    assert [(goal["id"], goal["status"]) for goal in goals] == [("b", "canceled"), ("a", None)]


def test_what_cannot_be_written_is_kept_and_written_later(tmp_path: Path) -> None:
    folder = tmp_path / "state"
    folder.write_text("in the way")
    ledger = Ledger(folder / "arm.sqlite", NAMES)
    switch(ledger, 0)
    ledger.accepted(1, "a", 1)
    assert "cannot be written" in eventually(lambda: ledger.fault)
    switch(ledger, 0, 1)
    ledger.ended(1, "succeeded", 0, "reached", 3)
    folder.unlink()
    eventually(lambda: ledger.fault is None)
    ledger.close()
    switches, goals = read(folder / "arm.sqlite")
    assert switches == {"1.left": 2, "1.diagonal": 1}
    assert [goal["status"] for goal in goals] == ["succeeded"]


def test_a_file_that_is_no_ledger_is_moved_aside_and_not_touched(path: Path) -> None:
    path.parent.mkdir()
    path.write_text("a letter, far longer than the head of any database would be" * 20)
    ledger = Ledger(path, NAMES)
    switch(ledger, 0)
    assert "was damaged" in eventually(lambda: ledger.damage)
    ledger.close()
    (aside,) = path.parent.glob("*.damaged-*")
    assert aside.read_text().startswith("a letter")
    assert read(path)[0] == {"1.left": 1}


def test_damaged_bytes_lose_no_count(path: Path) -> None:
    ledger = Ledger(path, NAMES)
    for _ in range(3):
        switch(ledger, 0, 2)
    eventually(lambda: written(path)[0] == {"1.left": 3, "1.right": 3})
    for part in path.parent.glob(f"{path.name}*"):
        if "-tally" not in part.name:
            part.write_bytes(b"\x5a" * part.stat().st_size)
    switch(ledger, 0)
    assert eventually(lambda: [fault.code for fault in ledger.faults()]) == ["ledger-damaged"]
    eventually(lambda: written(path)[0] == {"1.left": 4, "1.right": 3})
    ledger.close()
    assert list(path.parent.glob("*.damaged-*"))


def test_a_full_disk_loses_nothing_once_there_is_room(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    schema = module.SCHEMA
    monkeypatch.setattr(module, "SCHEMA", f"PRAGMA max_page_count=4; {schema}")
    ledger = Ledger(path, NAMES)
    for number in range(200):
        ledger.accepted(number, f"goal {number} of a long name that takes its room {'x' * 80}", 1)
    switch(ledger, 1)
    (fault,) = eventually(ledger.faults)
    assert (fault.code, "full" in fault.message) == ("ledger-unwritten", True)
    monkeypatch.setattr(module, "SCHEMA", f"PRAGMA max_page_count=100000; {schema}")
    eventually(lambda: not ledger.faults())
    ledger.close()
    assert read(path)[0] == {"1.diagonal": 1}
    assert len(read(path)[1]) == 200


def test_an_entry_with_no_text_form_does_not_end_it(ledger: Ledger, path: Path) -> None:
    ledger.accepted(1, "\udc80", 1)
    eventually(lambda: ledger.fault)
    ledger.close()


def test_only_the_latest_goals_are_kept(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "KEPT", 10)
    for _ in range(2):
        ledger = Ledger(path, NAMES)
        for k in range(8):
            ledger.accepted(k, str(k), 1)
            ledger.ended(k, "succeeded", 0, "reached", 1)
        ledger.close()
    assert [goal["id"] for goal in read(path)[1]] == [*"76543210", "7", "6"]


KILLED = """
import sys
import numpy as np
from pathlib import Path
from controller.daemon.ledger import Ledger

ledger = Ledger(Path(sys.argv[1]), ("1.left",))
for line in sys.stdin:
    ledger.intend(np.array([0], np.uint8), np.array([1], np.uint8))
    if line == "switch\\n":
        ledger.resolve(np.array([1], np.uint8))
    print("counted", flush=True)
"""


@pytest.mark.parametrize("left", [True, False])
def test_a_killed_process_loses_nothing_and_counts_what_its_last_sync_did(path: Path, left: bool) -> None:
    process = subprocess.Popen(
        [sys.executable, "-c", KILLED, str(path)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    try:
        assert process.stdin
        assert process.stdout
        for line in ["switch\n"] * 100 + ["intend\n"]:
            process.stdin.write(line)
            process.stdin.flush()
            assert process.stdout.readline() == "counted\n"
    finally:
        process.send_signal(signal.SIGKILL)
        process.communicate()
    again = Ledger(path, ("1.left",))
    outputs = np.array([left], np.uint8)  # what the boards tell: 1 if the last SYNC has left
    assert again.resolve(outputs).tolist() == [0] * left
    assert again.resolve(outputs).tolist() == []
    again.close()
    assert again.fault is None
    assert read(path)[0] == {"1.left": 100 + left}


def test_where_it_is(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.delenv("STATE_DIRECTORY", raising=False)
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    assert default_path("a") == tmp_path / "hyperbit" / "a.sqlite"
    monkeypatch.setenv("STATE_DIRECTORY", "/var/lib/hyperbit")
    assert default_path("a") == Path("/var/lib/hyperbit/a.sqlite")


def test_a_missing_ledger_is_an_error_and_not_made(path: Path) -> None:
    with pytest.raises(sqlite3.Error):
        read(path)
    assert not path.parent.exists()
