"""The switch journal: its counts survive every end of a process."""

import os
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from controller.executor.switch_journal import PAGE, FileJournal, JournalInUse, MemoryJournal, default_path

LABELS = [f"1.{k}" for k in range(11)]


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "deep" / "arm.switches"


def killed(journal: FileJournal) -> None:
    """Releases the file like the end of the process, without a further write."""
    os.close(journal._file)
    journal._map.close()


def test_counts_survive_a_killed_process(path: Path) -> None:
    journal = FileJournal(path, LABELS)
    journal.intend(0, 0b111)
    assert journal.resolve(0b111) == 0b111
    journal.intend(0b111, 0b110)
    killed(journal)
    journal = FileJournal(path, LABELS)
    assert journal.counts == [1, 1, 1] + [0] * 8
    assert journal.resolve(0b110) == 1, "the SYNC had left"
    assert (journal.counts[0], journal.resolve(0b110), journal.problem) == (2, 0, None)
    journal.close()


def test_intended_switches_that_did_not_happen_are_not_counted() -> None:
    journal = MemoryJournal(4)
    journal.intend(0b0011, 0b1100)
    assert journal.resolve(0b1011) == 0b1000
    assert journal.counts == [0, 0, 0, 1]


@given(st.integers(0, 100), st.integers(0, 3))
def test_a_torn_record_leaves_the_previous_one(tmp_path_factory: pytest.TempPathFactory, at: int, n: int) -> None:
    path = tmp_path_factory.mktemp("journal") / "j"
    journal = FileJournal(path, LABELS)
    for k in range(n):
        journal.intend(k, k + 1)
        journal.resolve(k + 1)
    last, number = list(journal.counts), journal._number
    journal.intend(0, 1)
    begin = PAGE + (number + 1) % 2 * journal._part
    journal._map[begin + at] ^= 0xFF
    killed(journal)
    journal = FileJournal(path, LABELS)
    assert (journal.counts, journal.problem) == (last, None)
    journal.close()


def test_a_damaged_file_is_reported_and_the_ledger_restores_the_counts(path: Path) -> None:
    journal = FileJournal(path, LABELS)
    journal.intend(0, 1)
    journal.resolve(1)
    killed(journal)
    path.write_bytes(os.urandom(path.stat().st_size))
    journal = FileJournal(path, LABELS)
    assert "damaged" in (journal.problem or "")
    journal.raise_to([7] * 11)
    journal.raise_to([3] * 11)
    journal.raise_to([9])
    assert journal.counts == [7] * 11
    journal.close()


def test_counts_of_other_actuators_are_not_taken_over(path: Path) -> None:
    journal = FileJournal(path, LABELS)
    journal.intend(0, 1)
    journal.resolve(1)
    journal.close()
    journal = FileJournal(path, LABELS[::-1])
    assert (sum(journal.counts), journal.problem is not None) == (0, True)
    journal.close()


def test_a_second_user_hears_who_the_first_is(path: Path) -> None:
    journal = FileJournal(path, LABELS)
    with pytest.raises(JournalInUse, match=f"in use by process {os.getpid()}"):
        FileJournal(path, LABELS)
    journal.close()
    FileJournal(path, LABELS).close()


def test_the_journal_is_in_the_services_folder(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("STATE_DIRECTORY", "/var/lib/hyperbit:/other")
    assert default_path("a") == Path("/var/lib/hyperbit/a.switches")
    monkeypatch.delenv("STATE_DIRECTORY")
    monkeypatch.setenv("XDG_STATE_HOME", "/states")
    assert default_path("a") == Path("/states/hyperbit/a.switches")
    monkeypatch.delenv("XDG_STATE_HOME")
    assert default_path("a") == Path.home() / ".local/state/hyperbit/a.switches"
