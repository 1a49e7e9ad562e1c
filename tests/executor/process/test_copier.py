"""The copier: counts of switches survive a power failure, and the event loop never waits for the disk."""

import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from hyperbit.controller.executor.process.journal_file import PAGE, FileJournal, shared_path
from hyperbit.controller.host.keeper import FileInUse, lock_file
from tests.executor.process.journals import LABELS, OFTEN, after_power_failure, killed, switched
from tests.waiting import eventually

KILLED = """
import os, signal, sys
from pathlib import Path
from hyperbit.controller.executor.process.journal_file import FileJournal
journal = FileJournal(Path(sys.argv[1]), [f"1.{k}" for k in range(11)])
journal.start_copier(1e6)
journal.intend(0, 0b11)
journal.resolve(0b11)
journal.intend(0b11, 0b111)
os.kill(os.getpid(), signal.SIGKILL)
"""

CALLED = """
import sys
from pathlib import Path
from hyperbit.controller.executor.process.journal_file import FileJournal
journal, called = FileJournal(Path(sys.argv[1]), [f"1.{k}" for k in range(11)]), set()
def note(_frame, event, function):
    if event == "c_call":
        called.add(f"{function.__module__ or type(function.__self__).__module__}.{function.__name__}")
for _ in range(2):
    journal.intend(0, 1)
    journal.resolve(1)
    sys.setprofile(note)
sys.setprofile(None)
print(*called)
"""


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "deep" / "arm.switches"


@pytest.fixture
def journal(path: Path) -> Iterator[FileJournal]:
    """A journal whose copier copies often."""
    journal = FileJournal(path, LABELS)
    journal.start_copier(OFTEN)
    yield journal
    journal.close()


def test_changed_counts_reach_the_disk_and_signals_do_not_end_the_copier(path: Path, journal: FileJournal) -> None:
    for number in (signal.SIGTERM, signal.SIGINT, signal.SIGHUP, signal.SIGABRT):
        os.kill(journal.copier.pid, number)
    for count in range(1, 4):
        switched(journal)
        eventually(lambda count=count: after_power_failure(path) == count)
    file = path.stat().st_ino
    time.sleep(10 * OFTEN)
    assert path.stat().st_ino == file, "it is written only if counts have changed"
    assert journal.problem is None


@pytest.mark.parametrize("length", [0, 1, PAGE, PAGE + 50])
def test_a_copy_that_is_cut_off_leaves_the_last_one_and_a_file_that_was_cut_off_is_replaced(
    path: Path, journal: FileJournal, length: int
) -> None:
    switched(journal)
    eventually(lambda: after_power_failure(path) == 1)
    path.with_name(f".{path.name}.1").write_bytes(path.read_bytes()[:length])
    assert after_power_failure(path) == 1
    os.truncate(path, length)
    switched(journal)
    eventually(lambda: path.stat().st_size == len(journal.mapped))
    eventually(lambda: after_power_failure(path) == 2)


@pytest.mark.parametrize("what", ["the file", "the folder"])
def test_a_file_that_is_gone_is_written_again(
    path: Path, journal: FileJournal, caplog: pytest.LogCaptureFixture, what: str
) -> None:
    switched(journal)
    eventually(lambda: path.read_bytes() == journal.mapped[:])
    shutil.rmtree(path.parent) if what == "the folder" else path.unlink()
    eventually(path.exists)
    eventually(lambda: journal.problem is None and f"{path} was deleted or moved, and is written again" in caplog.text)


def test_the_last_record_reaches_the_disk_after_a_kill(path: Path) -> None:
    ended = subprocess.run([sys.executable, "-c", KILLED, str(path)], stderr=subprocess.PIPE, text=True)
    assert ended.returncode == -signal.SIGKILL, ended.stderr

    def released() -> bool:
        try:
            os.close(lock_file(shared_path(path), ""))
        except FileInUse:  # the last copy
            return False
        return True

    eventually(released)
    shared_path(path).unlink()
    journal = FileJournal(path, LABELS)
    assert journal.counts[:4] == [1, 1, 0, 0]
    assert journal.resolve(0b111) == 0b100, "the intention is on the disk as well"
    journal.close()


def test_a_start_waits_for_the_last_copy_of_a_killed_executor(path: Path, journal: FileJournal) -> None:
    os.kill(journal.copier.pid, signal.SIGSTOP)
    switched(journal)
    journal.copier.stdin.close()
    killed(journal)
    waking = subprocess.Popen(["sh", "-c", f"sleep 0.3; kill -CONT {journal.copier.pid}"])
    later = FileJournal(path, LABELS, last_copy=60.0)
    assert journal.copier.wait(60) == waking.wait(60) == 0
    later.close()
    assert after_power_failure(path) == 1


def test_a_disk_that_hangs_at_the_end_is_left_to_the_copier(
    path: Path, journal: FileJournal, caplog: pytest.LogCaptureFixture
) -> None:
    eventually(path.exists)
    os.kill(journal.copier.pid, signal.SIGSTOP)  # as in a slow write
    switched(journal)
    journal.close()
    assert f"process {journal.copier.pid} still copies them" in (journal.problem or "")
    assert journal.problem in caplog.text
    assert (after_power_failure(path), shared_path(path).exists()) == (0, True)
    os.kill(journal.copier.pid, signal.SIGCONT)
    assert journal.copier.wait(60) == 0
    shared_path(path).unlink()
    assert after_power_failure(path) == 1


def test_a_copier_that_cannot_start_is_a_warning_and_the_end_copies(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    journal = FileJournal(path, LABELS)
    with monkeypatch.context() as patched:
        patched.setattr(sys, "executable", "/nowhere/python")
        journal.start_copier(OFTEN)
    assert "cannot be started" in (journal.problem or "")
    switched(journal).close()
    assert after_power_failure(path) == 1


def test_a_killed_copier_is_a_problem_and_the_end_copies(path: Path, journal: FileJournal) -> None:
    os.kill(journal.copier.pid, signal.SIGKILL)
    for _ in range(2):
        assert "has ended" in eventually(lambda: journal.problem)
    switched(journal).close()
    assert after_power_failure(path) == 1


def test_the_copier_keeps_no_file_of_the_executor_but_its_own(path: Path, journal: FileJournal) -> None:
    switched(journal)
    eventually(lambda: after_power_failure(path) == 1)
    folder = Path(f"/proc/{journal.copier.pid}/fd")
    opened = sorted(os.readlink(file).split(":")[0] for file in folder.iterdir())
    assert opened == sorted(["pipe", "pipe", "/dev/null", str(shared_path(path))])
    assert os.sched_getscheduler(journal.copier.pid) == os.SCHED_OTHER


def test_switching_calls_nothing_that_may_wait_for_a_file(path: Path) -> None:
    ended = subprocess.run([sys.executable, "-c", CALLED, str(path)], stdout=subprocess.PIPE, text=True, check=True)
    called = set(ended.stdout.split())
    rooms = {name.split(".")[0] for name in called}
    assert "zlib" in rooms, "the checksum shows that calls are seen"
    assert not rooms & {"posix", "_io", "io", "fcntl", "select", "mmap", "time", "_posixsubprocess"}, called
