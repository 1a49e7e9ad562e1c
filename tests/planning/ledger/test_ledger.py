"""The ledger: counts and results survive the death of the process."""

from pathlib import Path
from threading import Event
from typing import Any

import pytest

from hyperbit.controller.planning import ledger_file
from hyperbit.controller.planning.core.events import AcceptanceEntry, Identity, Record, ResultEntry
from hyperbit.controller.planning.ledger import Ledger
from hyperbit.controller.planning.ledger_file import find, owed, read
from tests.planning.ledger.records import EXECUTOR, NAMES, REACHED, SOON, accepted, ended, statuses
from tests.waiting import eventually


def test_counts_are_absolute_and_never_fall(ledger: Ledger, path: Path) -> None:
    ledger.counts([3, 0, 5])
    ledger.counts([2, 1, 6])
    ledger.counts([9, 9])  # of another arm
    assert ledger.known == (3, 1, 6)
    ledger.close()
    assert read(path)[0] == {"1.left": 3, "1.diagonal": 1, "1.right": 6}
    again = Ledger(path, ("1.right", "1.left", "2.left"))
    assert again.known == (6, 3, 0)
    again.close()


def test_goals_have_their_results(ledger: Ledger, path: Path) -> None:
    ledger.record(accepted(1, "a", waypoints=3))
    ledger.record(ended(1, ResultEntry(1.9e9, "succeeded", 0, "reached", 12)))
    ledger.record(accepted(2, "a"))
    ledger.record(ended(2, ResultEntry(1.9e9, "aborted", -4, "stuck", 1)))
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
    found, running = find(path, "a"), find(path, "b")  # the newest of an id
    assert found is not None
    assert (found["status"], found["code"], found["message"], found["switches"]) == ("aborted", -4, "stuck", 1)
    assert running is not None
    assert running["ended"] is None
    assert find(path, "c") is None


def test_the_next_run_owes_the_results_of_the_last_and_finds_their_goals(path: Path) -> None:
    ledger = Ledger(path, NAMES)
    assert ledger.owed == {}
    for program in (7, 8, 9):
        ledger.record(accepted(program, f"g{program}", waypoints=program))
    ledger.record(ended(8))
    ledger.close()
    again = Ledger(path, NAMES)
    assert again.owed == {Identity(EXECUTOR, n): AcceptanceEntry(f"g{n}", 1.8e9, n) for n in (7, 9)}
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
    assert [goal.goal for goal in owed(path).values()] == ["2", "3"]


def test_a_number_of_another_executor_is_another_goal(ledger: Ledger, path: Path) -> None:
    ledger.record(accepted(1, "of an executor that was killed", instance=5))
    ledger.record(accepted(1, "a", instance=6))
    ledger.record(ended(1, instance=6))
    ledger.close()
    assert statuses(path) == [("a", "succeeded"), ("of an executor that was killed", None)]


def test_what_comes_twice_changes_nothing(ledger: Ledger, path: Path) -> None:
    both = Record(3, Identity(EXECUTOR, 2), AcceptanceEntry("adopted", 1.8e9, 4), REACHED)
    for record in (accepted(1, "a"), ended(1), both):
        ledger.record(record)
        ledger.record(record)
    ledger.record(ended(1, ResultEntry(2.1e9, "aborted", -4, "late", 9)))
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


def test_records_that_wait_share_one_transaction(path: Path) -> None:
    transactions: list[int] = []
    writes, goes_on = Event(), Event()
    ledger = Ledger(path, NAMES, write_every=600.0)
    write = ledger.file.write

    def slow(records: Any, counts: Any) -> None:
        transactions.append(len(records))
        writes.set()
        goes_on.wait()
        write(records, counts)

    eventually(path.exists)
    ledger.file.write = slow  # type: ignore[method-assign]
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
