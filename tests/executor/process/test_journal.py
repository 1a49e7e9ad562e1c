"""The switch journal: its counts survive every end of a process."""

import os
import pickle
import resource
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hyperbit.controller.executor.arm.switch_journal import SwitchJournal
from hyperbit.controller.executor.process.journal_file import PAGE, FileJournal, default_path, shared_path
from hyperbit.controller.host.keeper import FileInUse
from tests.executor.process.journals import (
    LABELS,
    LIMITS,
    OFTEN,
    after_power_failure,
    counted,
    full_disk,
    killed,
    switched,
)
from tests.waiting import eventually


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "deep" / "arm.switches"


def test_intended_switches_that_did_not_happen_are_not_counted() -> None:
    journal = SwitchJournal(4)
    journal.intend(0b0011, 0b1100)
    assert journal.resolve(0b1011) == 0b1000
    assert journal.counts == [0, 0, 0, 1]


def test_a_journal_is_pickled_without_its_files(path: Path) -> None:
    journal = switched(FileJournal(path, LABELS), 0b101)
    journal.intend(0b101, 0b100)
    copy = pickle.loads(pickle.dumps(journal))
    assert type(copy) is SwitchJournal
    assert (copy.resolve(0b100), copy.counts) == (1, [2, 0, 1] + [0] * 8)
    assert journal.counts[0] == 1
    journal.close()


def test_counts_and_intentions_survive_a_killed_process(path: Path) -> None:
    journal = switched(FileJournal(path, LABELS), 0b111)
    journal.intend(0b111, 0b110)
    killed(journal)
    journal = FileJournal(path, LABELS)
    assert journal.counts == [1, 1, 1] + [0] * 8
    assert journal.resolve(0b110) == 1, "the SYNC had left"
    assert (journal.counts[0], journal.resolve(0b110), journal.problem) == (2, 0, None)
    journal.close()


@given(st.integers(0, 100), st.integers(0, 3))
def test_a_torn_record_leaves_the_previous_one(tmp_path_factory: pytest.TempPathFactory, at: int, n: int) -> None:
    path = tmp_path_factory.mktemp("journal") / "j"
    journal = FileJournal(path, LABELS)
    for k in range(n):
        journal.intend(k, k + 1)
        journal.resolve(k + 1)
    last, number = list(journal.counts), journal.number
    journal.intend(0, 1)
    journal.mapped[journal.slots[(number + 1) % 2] + at] ^= 0xFF
    killed(journal)
    assert counted(path, 11) == last


def test_a_damaged_file_is_reported_and_the_ledger_restores_the_counts(path: Path) -> None:
    killed(switched(FileJournal(path, LABELS)))
    path.write_bytes(os.urandom(path.stat().st_size))
    shared_path(path).unlink()
    journal = FileJournal(path, LABELS)
    [aside] = path.parent.glob(f"{path.name}.damaged-*")
    assert f"renamed to {aside.name}; counts of switches continue from the ledger's" in (journal.problem or "")
    journal.raise_to([7] * 11)
    journal.raise_to([3] * 11)
    journal.raise_to([9])
    assert journal.counts == [7] * 11
    journal.close()


def test_counts_of_other_actuators_are_not_taken_over(path: Path) -> None:
    switched(FileJournal(path, LABELS)).close()
    journal = FileJournal(path, LABELS[::-1])
    assert (sum(journal.counts), journal.problem is not None) == (0, True)
    journal.close()


def test_the_disk_is_written_at_the_end_and_a_power_failure_leaves_the_last_end(path: Path) -> None:
    journal = FileJournal(path, LABELS)
    before = path.read_bytes()
    switched(journal, 0b11)
    assert path.read_bytes() == before
    journal.close()
    assert path.read_bytes() != before
    assert not shared_path(path).exists()
    killed(switched(FileJournal(path, LABELS), 0b11))
    shared_path(path).unlink()
    assert counted(path) == [1, 1, 0]


def test_a_file_in_memory_replaces_a_damaged_one_on_the_disk(path: Path) -> None:
    killed(switched(FileJournal(path, LABELS), 0b11))
    path.write_bytes(b"\x5a" * 10_000)
    assert counted(path) == [1, 1, 0]


def test_a_file_that_systemd_keeps_is_used(path: Path, tmp_path: Path) -> None:
    kept = tmp_path / "kept"
    kept.touch()
    killed(switched(FileJournal(path, LABELS, kept.open("r+b", buffering=0)), 0b11))
    assert not shared_path(path).exists()
    assert counted(path, memory=kept.open("r+b", buffering=0)) == [1, 1, 0]


def test_a_disk_that_fails_at_the_end_leaves_the_file_in_memory(
    path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def fail(file: int) -> None:
        raise OSError("no space left")

    journal = switched(FileJournal(path, LABELS), 0b11)
    with monkeypatch.context() as patched:
        patched.setattr(os, "fsync", fail)
        journal.close()
    assert "no space left" in caplog.text
    path.unlink()
    assert counted(path) == [1, 1, 0]


@pytest.mark.parametrize("most", [0, 1, PAGE - 1, PAGE + 100])
def test_a_start_on_a_full_disk_is_a_warning_and_the_end_writes_what_it_can(path: Path, most: int) -> None:
    with full_disk(most) as memory:
        journal = FileJournal(path, LABELS, memory)
    assert f"cannot be written to {path}" in (journal.problem or "")
    switched(journal, 0b11).close()
    assert counted(path) == [1, 1, 0]


def test_a_full_disk_is_a_problem_until_it_is_freed(path: Path) -> None:
    with full_disk(PAGE) as memory:
        journal = FileJournal(path, LABELS, memory)
        journal.start_copier(OFTEN)
    assert journal.copier is not None
    for _ in range(2):
        eventually(lambda: f"cannot be written to {path}" in (journal.problem or ""))
        resource.prlimit(journal.copier.pid, resource.RLIMIT_FSIZE, LIMITS)
        eventually(lambda: journal.problem is None)
        resource.prlimit(journal.copier.pid, resource.RLIMIT_FSIZE, (PAGE, LIMITS[1]))
        switched(journal)
    resource.prlimit(journal.copier.pid, resource.RLIMIT_FSIZE, LIMITS)
    journal.close()


def test_a_folder_that_cannot_be_written_is_used_when_it_can(tmp_path: Path) -> None:
    blocked = tmp_path / "state"
    blocked.touch()  # no folder can be made here, as on a read-only disk; root may write everywhere else
    path = blocked / "arm.switches"
    killed(switched(FileJournal(path, LABELS), 0b11))
    journal = FileJournal(path, LABELS)
    assert f"cannot be written to {path}" in (journal.problem or "")
    assert journal.counts[:3] == [1, 1, 0]
    journal.start_copier(OFTEN)
    blocked.unlink()
    eventually(lambda: journal.problem is None)
    assert after_power_failure(path) == 1
    journal.close()
    assert counted(path) == [1, 1, 0]


def test_a_second_user_hears_who_the_first_is(path: Path) -> None:
    journal = FileJournal(path, LABELS)
    with pytest.raises(FileInUse, match=f"the switch journal {path} is in use by process {os.getpid()}"):
        FileJournal(path, LABELS, last_copy=0.0)
    journal.close()
    FileJournal(path, LABELS, last_copy=0.0).close()


def test_the_journal_is_in_the_services_folder(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("STATE_DIRECTORY", "/var/lib/hyperbit:/other")
    assert default_path("a") == Path("/var/lib/hyperbit/a.switches")
    monkeypatch.delenv("STATE_DIRECTORY")
    monkeypatch.setenv("XDG_STATE_HOME", "/states")
    assert default_path("a") == Path("/states/hyperbit/a.switches")
    assert default_path("a", simulated=True) == Path("/states/hyperbit/simulated/a.switches")
    monkeypatch.delenv("XDG_STATE_HOME")
    assert default_path("a") == Path.home() / ".local/state/hyperbit/a.switches"
