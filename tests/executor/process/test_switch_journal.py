"""The switch journal: its counts survive every end of a process."""

import os
import pickle
import resource
import shutil
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hyperbit.controller.executor.arm.switch_journal import SwitchJournal
from hyperbit.controller.executor.process.journal_file import PAGE, FileJournal, default_path, shared_path
from hyperbit.controller.host.keeper import FileInUse
from tests.waiting import eventually

LABELS = [f"1.{k}" for k in range(11)]


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "deep" / "arm.switches"


def killed(journal: FileJournal) -> None:
    """Releases the files like the end of the process, without a further write."""
    journal.mapped.close()
    journal.memory.close()


def switched(journal: FileJournal, states: int) -> None:
    journal.intend(0, states)
    journal.resolve(states)


def test_a_journal_is_pickled_without_its_files(path: Path) -> None:
    journal = FileJournal(path, LABELS)
    switched(journal, 0b101)
    journal.intend(0b101, 0b100)
    copy = pickle.loads(pickle.dumps(journal))
    assert type(copy) is SwitchJournal
    assert (copy.resolve(0b100), copy.counts) == (1, [2, 0, 1] + [0] * 8)
    assert journal.counts[0] == 1
    journal.close()


def test_counts_survive_a_killed_process(path: Path) -> None:
    journal = FileJournal(path, LABELS)
    assert journal.problem is None
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
    journal = SwitchJournal(4)
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
    last, number = list(journal.counts), journal.number
    journal.intend(0, 1)
    begin = journal.slots[(number + 1) % 2]
    journal.mapped[begin + at] ^= 0xFF
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
    shared_path(path).unlink()
    journal = FileJournal(path, LABELS)
    [aside] = path.parent.glob(f"{path.name}.damaged-*")
    assert f"renamed to {aside.name}; counts of switches continue from the ledger's" in (journal.problem or "")
    journal.raise_to([7] * 11)
    journal.raise_to([3] * 11)
    journal.raise_to([9])
    assert journal.counts == [7] * 11
    journal.close()


@pytest.mark.parametrize("what", ["the file", "the folder"])
def test_a_file_that_is_gone_is_written_again(path: Path, caplog: pytest.LogCaptureFixture, what: str) -> None:
    journal = FileJournal(path, LABELS)
    switched(journal, 0b11)
    journal.start_copier(0.05)
    eventually(lambda: path.read_bytes() == journal.mapped[:])
    shutil.rmtree(path.parent) if what == "the folder" else path.unlink()
    eventually(path.exists)
    eventually(lambda: journal.problem is None and f"{path} was deleted or moved, and is written again" in caplog.text)
    journal.close()


def test_the_disk_is_not_written_while_actuators_switch(path: Path) -> None:
    journal = FileJournal(path, LABELS)
    before = path.read_bytes()
    for states in range(100):
        switched(journal, states)
    assert path.read_bytes() == before
    journal.close()
    assert path.read_bytes() != before


def test_counts_survive_a_reboot_after_an_orderly_end(path: Path) -> None:
    journal = FileJournal(path, LABELS)
    switched(journal, 0b11)
    journal.close()
    assert not shared_path(path).exists()
    journal = FileJournal(path, LABELS)
    assert (journal.counts[:3], journal.problem) == ([1, 1, 0], None)
    journal.close()


def test_after_a_power_failure_the_counts_of_the_last_start_are_left(path: Path) -> None:
    journal = FileJournal(path, LABELS)
    switched(journal, 0b11)
    journal.close()
    journal = FileJournal(path, LABELS)
    switched(journal, 0b11)
    killed(journal)
    shared_path(path).unlink()
    journal = FileJournal(path, LABELS)
    assert (journal.counts[:3], journal.problem) == ([1, 1, 0], None)
    journal.close()


def test_a_file_in_memory_replaces_a_damaged_one_on_the_disk(path: Path) -> None:
    journal = FileJournal(path, LABELS)
    switched(journal, 0b11)
    killed(journal)
    path.write_bytes(b"\x5a" * 10_000)
    journal = FileJournal(path, LABELS)
    assert (journal.counts[:3], journal.problem) == ([1, 1, 0], None)
    journal.close()


def test_a_file_that_systemd_keeps_is_used(path: Path, tmp_path: Path) -> None:
    kept = tmp_path / "kept"
    kept.touch()
    journal = FileJournal(path, LABELS, kept.open("r+b", buffering=0))
    switched(journal, 0b11)
    killed(journal)
    assert not shared_path(path).exists()
    journal = FileJournal(path, LABELS, kept.open("r+b", buffering=0))
    assert journal.counts[:3] == [1, 1, 0]
    journal.close()


def test_a_disk_that_fails_at_the_end_leaves_the_file_in_memory(
    path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def fail(file: int) -> None:
        raise OSError("no space left")

    journal = FileJournal(path, LABELS)
    switched(journal, 0b11)
    with monkeypatch.context() as patched:
        patched.setattr(os, "fsync", fail)
        journal.close()
    assert "no space left" in caplog.text
    path.unlink()
    journal = FileJournal(path, LABELS)
    assert journal.counts[:3] == [1, 1, 0]
    journal.close()


def restarted(journal: FileJournal, path: Path) -> list[int]:
    journal.close()
    journal = FileJournal(path, LABELS)
    counts = journal.counts[:3]
    journal.close()
    return counts


@pytest.mark.parametrize("most", [0, 1, PAGE - 1, PAGE + 100])
def test_a_start_on_a_full_disk_is_a_warning_and_the_end_writes_what_it_can(path: Path, most: int) -> None:
    memory = os.fdopen(os.memfd_create("journal"), "r+b", buffering=0)
    memory.truncate(16 * PAGE)
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (most, before[1]))  # a write fails or is cut short, as on a full disk
    try:
        journal = FileJournal(path, LABELS, memory)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert f"cannot be written to {path}" in (journal.problem or "")
    switched(journal, 0b11)
    assert restarted(journal, path) == [1, 1, 0]


def test_a_start_without_a_writable_folder_is_a_warning(tmp_path: Path) -> None:
    blocked = tmp_path / "state"
    blocked.touch()  # no folder can be made here, as on a read-only disk; root may write everywhere else
    path = blocked / "arm.switches"
    journal = FileJournal(path, LABELS)
    assert f"cannot be written to {path}" in (journal.problem or "")
    switched(journal, 0b11)
    with pytest.raises(FileInUse):
        FileJournal(path, LABELS)
    killed(journal)
    journal = FileJournal(path, LABELS)
    assert journal.counts[:3] == [1, 1, 0]
    blocked.unlink()
    assert restarted(journal, path) == [1, 1, 0]
    assert path.exists()


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
    with pytest.raises(FileInUse, match=f"in use by process {os.getpid()}"):
        FileJournal(path, LABELS)
    journal.close()
    FileJournal(path, LABELS).close()


def test_the_journal_is_in_the_services_folder(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("STATE_DIRECTORY", "/var/lib/hyperbit:/other")
    assert default_path("a") == Path("/var/lib/hyperbit/a.switches")
    monkeypatch.delenv("STATE_DIRECTORY")
    monkeypatch.setenv("XDG_STATE_HOME", "/states")
    assert default_path("a") == Path("/states/hyperbit/a.switches")
    assert default_path("a", simulated=True) == Path("/states/hyperbit/simulated/a.switches")
    monkeypatch.delenv("XDG_STATE_HOME")
    assert default_path("a") == Path.home() / ".local/state/hyperbit/a.switches"
