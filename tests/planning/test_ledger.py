"""The ledger: counts and results survive damage of the file and the death of the process."""

import signal
import sqlite3
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from controller.planning import ledger_file
from controller.planning.ledger import Ledger, LedgerInUse
from controller.planning.ledger_file import counted, default_path, read
from tests.waiting import eventually

NAMES = ("1.left", "1.diagonal", "1.right")
SOON = 0.05  # [s] between two transactions


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "state" / "arm.sqlite"


@pytest.fixture
def ledger(path: Path) -> Iterator[Ledger]:
    ledger = Ledger(path, NAMES, SOON)
    yield ledger
    ledger.close()


def configuration_text(path: Path) -> tuple[dict[str, int], list[dict[str, Any]]]:
    """Returns the content of the file, which may not exist yet."""
    try:
        return read(path)
    except sqlite3.Error:
        return {}, []


def test_counts_are_absolute_and_never_fall(ledger: Ledger, path: Path) -> None:
    ledger.counts([3, 0, 5])
    ledger.counts([2, 1, 6])
    assert ledger.known() == (3, 1, 6)
    ledger.close()
    assert read(path)[0] == {"1.left": 3, "1.diagonal": 1, "1.right": 6}


def test_counts_of_another_arm_are_not_taken(ledger: Ledger) -> None:
    ledger.counts([3, 0])
    assert ledger.known() == (0, 0, 0)


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


def test_a_result_of_the_next_run_of_the_planner_finds_its_goal(path: Path) -> None:
    ledger = Ledger(path, NAMES)
    ledger.accepted(7, "a", 1)
    ledger.close()
    again = Ledger(path, NAMES)
    again.ended(7, "succeeded", 0, "reached", 2)
    again.ended(8, "aborted", -4, "of nobody", 2)
    again.close()
    assert [(goal["id"], goal["status"]) for goal in read(path)[1]] == [("a", "succeeded")]


def test_a_number_that_comes_again_names_its_latest_goal(ledger: Ledger, path: Path) -> None:
    ledger.accepted(1, "of an executor that was killed", 1)
    ledger.accepted(1, "a", 1)
    ledger.ended(1, "succeeded", 0, "reached", 2)
    ledger.close()
    assert [goal["status"] for goal in read(path)[1]] == ["succeeded", None]


def test_it_continues_with_the_counts_of_before(ledger: Ledger, path: Path) -> None:
    ledger.counts([4, 0, 1])
    ledger.close()
    again = Ledger(path, ("1.right", "1.left", "2.left"))
    assert again.known() == (1, 4, 0)
    again.close()


def test_the_end_of_a_goal_is_written_at_once_and_a_flood_in_batches(path: Path) -> None:
    ledger = Ledger(path, NAMES, write_every=600.0)
    eventually(path.exists)
    ledger.close()
    transactions: list[int] = []
    ledger = Ledger(path, NAMES, write_every=600.0)
    write = ledger._file.write
    ledger._file.write = lambda goals, counts: (transactions.append(len(goals)), write(goals, counts))[1]  # type: ignore[method-assign,assign,func-returns-value]
    for k in range(100):
        ledger.counts([k, 0, 0])
        ledger.accepted(k, str(k), 1)
        ledger.ended(k, "succeeded", 0, "reached", 1)
    ledger.close()
    assert sum(transactions) == 200
    assert len(transactions) <= 2
    assert read(path)[0] == {"1.left": 99}


def test_what_cannot_be_written_is_kept_and_written_later(tmp_path: Path) -> None:
    folder = tmp_path / "state"
    folder.write_text("in the way")
    ledger = Ledger(folder / "arm.sqlite", NAMES, SOON)
    ledger.counts([1, 0, 0])
    ledger.accepted(1, "a", 1)
    eventually(lambda: ledger.fault)
    assert [fault.code for fault in ledger.faults()] == ["ledger-unwritten"]
    ledger.ended(1, "succeeded", 0, "reached", 3)
    folder.unlink()
    eventually(lambda: ledger.fault is None)
    ledger.close()
    switches, goals = read(folder / "arm.sqlite")
    assert switches == {"1.left": 1}
    assert [goal["status"] for goal in goals] == ["succeeded"]


def test_a_file_that_is_no_ledger_is_moved_aside_and_the_counts_come_from_the_executor(path: Path) -> None:
    path.parent.mkdir()
    path.write_text("a letter, far longer than the head of any database would be" * 20)
    ledger = Ledger(path, NAMES, SOON)
    eventually(lambda: ledger.damage)
    assert ledger.known() == (0, 0, 0)
    ledger.counts([5, 6, 7])
    assert [fault.code for fault in ledger.faults()] == ["ledger-damaged"]
    ledger.close()
    (aside,) = path.parent.glob("*.damaged-*")
    assert aside.read_text().startswith("a letter")
    assert read(path)[0] == {"1.left": 5, "1.diagonal": 6, "1.right": 7}


def test_bytes_damaged_while_it_is_open_lose_no_count(path: Path) -> None:
    ledger = Ledger(path, NAMES, SOON)
    ledger.counts([3, 0, 3])
    eventually(lambda: configuration_text(path)[0] == {"1.left": 3, "1.right": 3})
    for part in path.parent.glob(f"{path.name}*"):
        if part.suffix != ".lock":
            part.write_bytes(b"\x5a" * part.stat().st_size)
    ledger.counts([4, 0, 3])
    eventually(lambda: configuration_text(path)[0] == {"1.left": 4, "1.right": 3})
    ledger.close()
    assert ledger.damage
    assert list(path.parent.glob("*.damaged-*"))


def test_a_file_that_was_deleted_is_made_again_with_all_counts(ledger: Ledger, path: Path) -> None:
    ledger.counts([3, 0, 3])
    eventually(lambda: configuration_text(path)[0])
    for part in path.parent.glob(f"{path.name}*"):
        if part.suffix != ".lock":
            part.unlink()
    ledger.counts([4, 0, 3])
    eventually(lambda: configuration_text(path)[0] == {"1.left": 4, "1.right": 3})
    assert ledger.faults() == ()


def test_a_full_disk_loses_nothing_once_there_is_room(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    schema = ledger_file.SCHEMA
    monkeypatch.setattr(ledger_file, "SCHEMA", f"PRAGMA max_page_count=5; {schema}")
    ledger = Ledger(path, NAMES, SOON)
    for number in range(200):
        ledger.accepted(number, f"goal {number} of a long name that takes its room {'x' * 80}", 1)
    ledger.counts([0, 1, 0])
    (fault,) = eventually(ledger.faults)
    assert (fault.code, "full" in fault.message) == ("ledger-unwritten", True)
    monkeypatch.setattr(ledger_file, "SCHEMA", f"PRAGMA max_page_count=100000; {schema}")
    eventually(lambda: not ledger.faults())
    ledger.close()
    assert read(path)[0] == {"1.diagonal": 1}
    assert len(read(path)[1]) == 200


def test_text_that_has_no_utf8_is_written_out(ledger: Ledger, path: Path) -> None:
    ledger.accepted(1, "\udc80", 1)
    ledger.close()
    assert read(path)[1][0]["id"] == "\\udc80"


def test_only_the_latest_goals_are_kept(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ledger_file, "MOST_GOALS", 10)
    for _ in range(2):
        ledger = Ledger(path, NAMES, SOON)
        for k in range(8):
            ledger.accepted(k, str(k), 1)
            ledger.ended(k, "succeeded", 0, "reached", 1)
        ledger.close()
    assert [goal["id"] for goal in read(path)[1]] == [*"76543210", "7", "6"]


def test_a_ledger_of_an_earlier_version_is_taken_over(path: Path) -> None:
    path.parent.mkdir()
    connection = sqlite3.connect(path)
    connection.executescript(ledger_file.SCHEMA.replace(", program INTEGER", ""))
    connection.execute("INSERT INTO switches VALUES ('1.left', 5)")
    connection.execute("INSERT INTO goals (id, accepted, waypoints) VALUES ('old', 1.0, 1)")
    connection.commit()
    connection.close()
    ledger = Ledger(path, NAMES, SOON)
    assert ledger.known() == (5, 0, 0)
    ledger.accepted(1, "new", 1)
    ledger.ended(1, "succeeded", 0, "reached", 1)
    ledger.close()
    assert ledger.faults() == ()
    assert [(goal["id"], goal["status"]) for goal in read(path)[1]] == [("new", "succeeded"), ("old", None)]


HOLDER = """
import sys
from pathlib import Path
from controller.planning.ledger import Ledger

ledger = Ledger(Path(sys.argv[1]), ("1.left",), 0.01)
ledger.counts([7])
ledger.accepted(1, "a", 1)
while ledger._goals:
    pass
print("written", flush=True)
sys.stdin.read()
"""


def test_one_process_has_the_ledger_and_a_killed_one_frees_it_and_loses_nothing(path: Path) -> None:
    command = [sys.executable, "-c", HOLDER, str(path)]
    holder = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    try:
        assert holder.stdout
        assert holder.stdout.readline() == "written\n"
        with pytest.raises(LedgerInUse, match=f"in use by another daemon, process {holder.pid}"):
            Ledger(path, NAMES)
    finally:
        holder.send_signal(signal.SIGKILL)
        holder.communicate()
    again = Ledger(path, NAMES)
    assert again.known() == (7, 0, 0)
    again.close()
    assert [goal["id"] for goal in read(path)[1]] == ["a"]


def test_the_same_process_may_open_it_again_after_closing(path: Path) -> None:
    Ledger(path, NAMES).close()
    Ledger(path, NAMES).close()


def test_the_folder_is_that_of_systemd_or_of_the_user(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.delenv("STATE_DIRECTORY", raising=False)
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    assert default_path("a") == tmp_path / "hyperbit" / "a.sqlite"
    monkeypatch.setenv("STATE_DIRECTORY", "/var/lib/hyperbit")
    assert default_path("a") == Path("/var/lib/hyperbit/a.sqlite")


def test_a_missing_ledger_is_an_error_and_not_made(path: Path) -> None:
    with pytest.raises(sqlite3.Error):
        read(path)
    assert counted(path) == {}
    assert not path.parent.exists()


def test_the_goal_of_a_planner_that_was_killed_before_it_wrote_comes_with_its_result(path: Path) -> None:
    killed, begun = ("lost", time.time() - 3.0, 2), time.time()
    again = Ledger(path, NAMES, SOON)
    again.accepted(6, "known", 1)
    again.ended(6, "succeeded", 0, "reached", 1, ("known", begun, 1))
    again.ended(7, "aborted", -4, "the planner is gone", 3, killed)
    again.ended(7, "aborted", -4, "the planner is gone", 3, killed)  # sent again until it is acknowledged
    again.close()
    lost, known = read(path)[1]
    assert (lost["id"], lost["accepted"], lost["waypoints"]) == killed
    assert (lost["status"], lost["code"], lost["message"], lost["switches"]) == (
        "aborted",
        -4,
        "the planner is gone",
        3,
    )
    assert (known["id"], known["status"]) == ("known", "succeeded")


def test_the_first_start_is_no_word_in_the_log(tmp_path, caplog):
    caplog.set_level("INFO")
    assert counted(tmp_path / "none.sqlite") == {}
    assert not caplog.records
