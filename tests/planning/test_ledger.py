"""The ledger: counts and results survive damage of the file and the death of the process."""

import signal
import sqlite3
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from threading import Event
from typing import Any

import pytest

from controller.planning import ledger_file
from controller.planning.core.events import Accepted, Ended, Identity, OpenGoal, Record
from controller.planning.ledger import Ledger, LedgerInUse
from controller.planning.ledger_file import counted, default_path, owed, read
from tests.waiting import eventually

NAMES = ("1.left", "1.diagonal", "1.right")
SOON = 0.05  # [s] between two transactions
EXECUTOR = 2**62  # the greatest instance
REACHED = Ended(2e9, "succeeded", 0, "reached", 2)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "state" / "arm.sqlite"


@pytest.fixture
def ledger(path: Path) -> Iterator[Ledger]:
    ledger = Ledger(path, NAMES, write_every=SOON)
    yield ledger
    ledger.close()


def accepted(program: int, goal: str, instance: int = EXECUTOR, waypoints: int = 1) -> Record:
    return Record(2 * program, Identity(instance, program), Accepted(goal, 1.8e9, waypoints), None)


def ended(program: int, result: Ended = REACHED, instance: int = EXECUTOR) -> Record:
    return Record(2 * program + 1, Identity(instance, program), None, result)


def statuses(path: Path) -> list[tuple[str, str | None]]:
    """Returns id and status of each goal, newest first."""
    return [(goal["id"], goal["status"]) for goal in read(path)[1]]


def configuration_text(path: Path) -> tuple[dict[str, int], list[dict[str, Any]]]:
    """Returns the content of the file, which may not exist yet."""
    try:
        return read(path)
    except sqlite3.Error:
        return {}, []


def test_counts_are_absolute_and_never_fall(ledger: Ledger, path: Path) -> None:
    ledger.counts([3, 0, 5])
    ledger.counts([2, 1, 6])
    assert ledger.known == (3, 1, 6)
    ledger.close()
    assert read(path)[0] == {"1.left": 3, "1.diagonal": 1, "1.right": 6}


def test_counts_of_another_arm_are_not_taken(ledger: Ledger) -> None:
    ledger.counts([3, 0])
    assert ledger.known == (0, 0, 0)


def test_goals_have_their_results(ledger: Ledger, path: Path) -> None:
    ledger.record(accepted(1, "a", waypoints=3))
    ledger.record(ended(1, Ended(1.9e9, "succeeded", 0, "reached", 12)))
    ledger.record(accepted(2, "a"))
    ledger.record(ended(2, Ended(1.9e9, "aborted", -4, "stuck", 1)))
    ledger.record(accepted(3, "b"))
    ledger.close()
    goals = read(path)[1]
    assert [(g["id"], g["waypoints"], g["status"], g["code"], g["message"], g["switches"]) for g in goals] == [
        ("b", 1, None, None, None, None),
        ("a", 1, "aborted", -4, "stuck", 1),
        ("a", 3, "succeeded", 0, "reached", 12),
    ]
    assert (goals[1]["accepted"], goals[1]["ended"]) == (1.8e9, 1.9e9)
    assert {(goal["instance"], goal["program"]) for goal in goals} == {(EXECUTOR, 1), (EXECUTOR, 2), (EXECUTOR, 3)}


def test_the_next_run_owes_the_results_of_the_last_and_finds_their_goals(path: Path) -> None:
    ledger = Ledger(path, NAMES)
    assert ledger.owed == ()
    for program in (7, 8, 9):
        ledger.record(accepted(program, f"g{program}", waypoints=program))
    ledger.record(ended(8))
    ledger.close()
    again = Ledger(path, NAMES)
    assert again.owed == tuple(OpenGoal(Identity(EXECUTOR, n), f"g{n}", 1.8e9, n) for n in (7, 9))
    again.record(ended(7))
    again.record(ended(10))  # of nobody
    again.close()
    assert statuses(path) == [("g9", None), ("g8", "succeeded"), ("g7", "succeeded")]


def test_the_newest_goals_are_owed(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ledger_file, "MOST_OWED", 2)
    ledger = Ledger(path, NAMES)
    for program in (1, 2, 3):
        ledger.record(accepted(program, str(program)))
    ledger.close()
    assert [goal.goal for goal in owed(path)] == ["2", "3"]


def test_a_number_of_another_executor_is_another_goal(ledger: Ledger, path: Path) -> None:
    ledger.record(accepted(1, "of an executor that was killed", instance=5))
    ledger.record(accepted(1, "a", instance=6))
    ledger.record(ended(1, instance=6))
    ledger.close()
    assert statuses(path) == [("a", "succeeded"), ("of an executor that was killed", None)]


def test_what_comes_twice_changes_nothing(ledger: Ledger, path: Path) -> None:
    both = Record(3, Identity(EXECUTOR, 2), Accepted("adopted", 1.8e9, 4), REACHED)
    for record in (accepted(1, "a"), ended(1), both):
        ledger.record(record)
        ledger.record(record)
    ledger.record(ended(1, Ended(2.1e9, "aborted", -4, "late", 9)))
    ledger.close()
    assert statuses(path) == [("adopted", "succeeded"), ("a", "succeeded")]
    adopted, goal = read(path)[1]
    assert (adopted["accepted"], adopted["waypoints"], adopted["ended"]) == (1.8e9, 4, 2e9)
    assert goal["ended"] == 2e9


def test_each_record_is_reported_once_when_it_is_in_the_file(path: Path) -> None:
    seen: list[tuple[int, int]] = []
    ledger = Ledger(path, NAMES, recorded=lambda number: seen.append((number, len(read(path)[1]))), write_every=600.0)
    ledger.record(accepted(1, "a"))
    eventually(lambda: seen)
    ledger.record(accepted(2, "b"))
    ledger.record(ended(2))
    ledger.close()
    assert seen == [(2, 1), (4, 2), (5, 2)]


def test_a_thread_that_dies_is_fatal(path: Path) -> None:
    def broken(_: int) -> None:
        raise RuntimeError("the core is gone")

    messages: list[str] = []
    ledger = Ledger(path, NAMES, broken, messages.append)
    ledger.record(accepted(1, "a"))
    assert eventually(lambda: messages) == ["the ledger's thread ended: RuntimeError('the core is gone')"]
    ledger.close()


def test_it_continues_with_the_counts_of_before(ledger: Ledger, path: Path) -> None:
    ledger.counts([4, 0, 1])
    ledger.close()
    again = Ledger(path, ("1.right", "1.left", "2.left"))
    assert again.known == (1, 4, 0)
    again.close()


def test_records_that_wait_share_one_transaction(path: Path) -> None:
    transactions: list[int] = []
    writes, goes_on = Event(), Event()
    ledger = Ledger(path, NAMES, write_every=600.0)
    write = ledger._file.write

    def slow(records: Any, counts: Any) -> None:
        transactions.append(len(records))
        writes.set()
        goes_on.wait()
        write(records, counts)

    eventually(path.exists)
    ledger._file.write = slow  # type: ignore[method-assign]
    ledger.record(accepted(0, "first"))
    writes.wait()
    for k in range(1, 100):
        ledger.counts([k, 0, 0])
        ledger.record(accepted(k, str(k)))
        ledger.record(ended(k))
    goes_on.set()
    ledger.close()
    assert sum(transactions) == 199
    assert len(transactions) <= 4, "the first transaction of all may be the slow one"
    assert read(path)[0] == {"1.left": 99}


def test_counts_alone_wait(path: Path) -> None:
    written: list[int] = []
    ledger = Ledger(path, NAMES, written.append, write_every=600.0)
    ledger.record(accepted(1, "a"))
    eventually(lambda: written)
    ledger.counts([1, 0, 0])
    ledger.counts([2, 0, 0])
    assert ledger.known == (2, 0, 0)
    assert read(path)[0] == {}
    ledger.close()
    assert read(path)[0] == {"1.left": 2}


def test_what_cannot_be_written_is_kept_and_written_later(tmp_path: Path) -> None:
    folder = tmp_path / "state"
    folder.write_text("in the way")
    reported: list[int] = []
    ledger = Ledger(folder / "arm.sqlite", NAMES, reported.append, write_every=SOON)
    ledger.counts([1, 0, 0])
    ledger.record(accepted(1, "a"))
    eventually(lambda: reported)
    assert [fault.code for fault in ledger.faults()] == ["ledger-unwritten"]
    ledger.record(ended(1))
    eventually(lambda: len(reported) == 2)
    folder.unlink()
    eventually(lambda: ledger.fault is None)
    ledger.close()
    switches, goals = read(folder / "arm.sqlite")
    assert switches == {"1.left": 1}
    assert [goal["status"] for goal in goals] == ["succeeded"]
    assert reported == [2, 3]


def test_a_file_that_is_no_ledger_is_moved_aside_and_the_counts_come_from_the_executor(path: Path) -> None:
    path.parent.mkdir()
    path.write_text("a letter, far longer than the head of any database would be" * 20)
    ledger = Ledger(path, NAMES, write_every=SOON)
    eventually(lambda: ledger.damage)
    assert ledger.known == (0, 0, 0)
    ledger.counts([5, 6, 7])
    assert [fault.code for fault in ledger.faults()] == ["ledger-damaged"]
    ledger.close()
    (aside,) = path.parent.glob("*.damaged-*")
    assert aside.read_text().startswith("a letter")
    assert read(path)[0] == {"1.left": 5, "1.diagonal": 6, "1.right": 7}


def test_bytes_damaged_while_it_is_open_lose_no_count(path: Path) -> None:
    ledger = Ledger(path, NAMES, write_every=SOON)
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
    monkeypatch.setattr(ledger_file, "SCHEMA", f"PRAGMA max_page_count=6; {schema}")
    ledger = Ledger(path, NAMES, write_every=SOON)
    for number in range(200):
        ledger.record(accepted(number, f"goal {number} of a long name that takes its room {'x' * 80}"))
    ledger.counts([0, 1, 0])
    (fault,) = eventually(ledger.faults)
    assert (fault.code, "full" in fault.message) == ("ledger-unwritten", True)
    monkeypatch.setattr(ledger_file, "SCHEMA", f"PRAGMA max_page_count=100000; {schema}")
    eventually(lambda: not ledger.faults())
    ledger.close()
    assert read(path)[0] == {"1.diagonal": 1}
    assert len(read(path)[1]) == 200


def test_text_that_has_no_utf8_is_written_out(ledger: Ledger, path: Path) -> None:
    ledger.record(accepted(1, "\udc80"))
    ledger.record(ended(1, REACHED._replace(message="\udc81")))
    ledger.close()
    assert (read(path)[1][0]["id"], read(path)[1][0]["message"]) == ("\\udc80", "\\udc81")


def test_only_the_latest_goals_are_kept(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ledger_file, "MOST_GOALS", 10)
    for instance in range(2):
        ledger = Ledger(path, NAMES, write_every=SOON)
        for k in range(8):
            ledger.record(accepted(k, str(k), instance))
            ledger.record(ended(k, instance=instance))
        ledger.close()
    assert [goal["id"] for goal in read(path)[1]] == [*"76543210", "7", "6"]


@pytest.mark.parametrize("missing", [", program INTEGER, instance INTEGER", ", instance INTEGER"])
def test_a_ledger_of_an_earlier_version_is_taken_over(path: Path, missing: str) -> None:
    path.parent.mkdir()
    with sqlite3.connect(path) as connection:
        connection.executescript(ledger_file.SCHEMA.replace(missing, ""))
        connection.execute("INSERT INTO switches VALUES ('1.left', 5)")
        connection.execute(
            "INSERT INTO goals (id, accepted, waypoints, status, ended) VALUES ('a', 1, 1, 'aborted', 2)"
        )
        connection.execute("INSERT INTO goals (id, accepted, waypoints) VALUES ('open', 1.0, 1)")
        if "program" not in missing:
            connection.execute("CREATE INDEX unfinished ON goals (program) WHERE ended IS NULL")
            connection.execute("INSERT INTO goals (id, accepted, waypoints, program) VALUES ('7', 1.0, 1, 1)")
    connection.close()
    assert statuses(path)[-2:] == [("open", None), ("a", "aborted")]
    ledger = Ledger(path, NAMES, write_every=SOON)
    assert ledger.known == (5, 0, 0)
    assert ledger.owed == ()
    ledger.record(accepted(1, "new"))
    ledger.record(ended(1))
    ledger.close()
    assert ledger.faults() == ()
    found = statuses(path)
    assert (found[0], found[-2:]) == (("new", "succeeded"), [("open", "lost"), ("a", "aborted")])
    assert all(status == "lost" for _, status in found[1:-1])
    assert owed(path) == ()


HOLDER = """
import sys
from pathlib import Path
from controller.planning.core.events import Accepted, Identity, Record
from controller.planning.ledger import Ledger

ledger = Ledger(Path(sys.argv[1]), ("1.left",), lambda number: print(number, flush=True), write_every=600.0)
ledger.counts([7])
ledger.record(Record(12, Identity(3, 1), Accepted("a", 1.8e9, 2), None))
sys.stdin.read()
"""


def test_one_process_has_the_ledger_and_a_killed_one_frees_it_and_loses_nothing(path: Path) -> None:
    command = [sys.executable, "-c", HOLDER, str(path)]
    holder = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    try:
        assert holder.stdout
        assert holder.stdout.readline() == "12\n"
        with pytest.raises(LedgerInUse, match=f"in use by another daemon, process {holder.pid}"):
            Ledger(path, NAMES)
    finally:
        holder.send_signal(signal.SIGKILL)
        holder.communicate()
    again = Ledger(path, NAMES)
    assert again.known == (7, 0, 0)
    assert again.owed == (OpenGoal(Identity(3, 1), "a", 1.8e9, 2),)
    again.close()


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
    assert (counted(path), owed(path)) == ({}, ())
    assert not path.parent.exists()


def test_the_first_start_is_no_word_in_the_log(tmp_path, caplog):
    caplog.set_level("INFO")
    assert counted(tmp_path / "none.sqlite") == {}
    assert not caplog.records
