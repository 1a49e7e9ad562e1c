"""The copier: counts of switches survive a power failure, and the event loop never waits for the disk."""

import os
import resource
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from hyperbit.controller.executor.process import journal_file
from hyperbit.controller.executor.process.journal_file import PAGE, FileJournal, shared_path
from hyperbit.controller.host.keeper import FileInUse, lock_file
from tests.waiting import eventually

LABELS = [f"1.{k}" for k in range(11)]
OFTEN, NEVER = 0.02, 1e6  # [s] between two copies

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


class Bench:
    """A journal whose copier writes at each interval."""

    def __init__(self, path: Path, interval: float) -> None:
        self.path, self.journal = path, FileJournal(path, LABELS)
        self.journal.start_copier(interval)

    @property
    def copier(self) -> subprocess.Popen[bytes]:
        assert self.journal.copier is not None
        return self.journal.copier

    def switch(self, times: int = 1) -> None:
        for _ in range(times):
            self.journal.intend(0, 1)
            self.journal.resolve(1)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "arm.switches"


@pytest.fixture
def bench(path: Path) -> Iterator[Bench]:
    bench = Bench(path, OFTEN)
    yield bench
    bench.journal.close()


def after_power_failure(path: Path) -> list[int]:
    """Returns the counts that an executor finds on a copy of the disk's file, without the file in memory."""
    other = path.with_name("after.switches")
    shutil.copyfile(path, other)
    journal = FileJournal(other, LABELS)
    assert journal.problem is None
    journal.close()
    return journal.counts


def test_counts_reach_the_disk_while_the_executor_runs(bench: Bench) -> None:
    for count in range(1, 4):
        bench.switch()
        eventually(lambda count=count: after_power_failure(bench.path)[0] == count)
    assert bench.journal.problem is None


def test_signals_to_all_processes_of_the_executor_do_not_end_the_copier(bench: Bench) -> None:
    for number in (signal.SIGTERM, signal.SIGINT, signal.SIGHUP, signal.SIGABRT):
        os.kill(bench.copier.pid, number)
    bench.switch()
    eventually(lambda: after_power_failure(bench.path)[0] == 1)


def test_the_disk_is_written_only_if_counts_have_changed(bench: Bench) -> None:
    bench.switch()
    eventually(lambda: after_power_failure(bench.path)[0] == 1)
    file = bench.path.stat().st_ino
    time.sleep(10 * OFTEN)
    assert bench.path.stat().st_ino == file
    bench.switch()
    eventually(lambda: bench.path.stat().st_ino != file)


@pytest.mark.parametrize("length", [0, 1, PAGE, PAGE + 50])
def test_a_copy_that_a_power_failure_cuts_off_leaves_the_last_one(path: Path, length: int) -> None:
    bench = Bench(path, NEVER)
    bench.switch()
    bench.journal.save()
    path.with_name(f".{path.name}.1").write_bytes(path.read_bytes()[:length])
    assert after_power_failure(path)[0] == 1
    bench.journal.close()


def test_a_copy_that_fails_leaves_the_last_one(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    bench = Bench(path, NEVER)
    before = path.read_bytes()
    bench.switch()
    with monkeypatch.context() as patched:
        patched.setattr(Path, "replace", lambda *_: (_ for _ in ()).throw(OSError("no space left")))
        bench.journal.save()
    assert "no space left" in (bench.journal.problem or "")
    assert (path.read_bytes(), list(path.parent.iterdir())) == (before, [path])
    bench.journal.close()


@pytest.mark.parametrize("length", [0, 1, PAGE, PAGE + 50])
def test_a_file_that_was_cut_off_is_replaced_by_the_next_copy(bench: Bench, length: int) -> None:
    eventually(lambda: bench.path.exists())
    os.truncate(bench.path, length)
    bench.switch()
    eventually(lambda: bench.path.stat().st_size == len(bench.journal.mapped))
    eventually(lambda: after_power_failure(bench.path)[0] == 1)


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


def test_a_start_waits_for_the_last_copy_of_a_killed_executor(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("hyperbit.controller.executor.process.journal_file.LAST_COPY", 60.0)
    bench = Bench(path, NEVER)
    bench.switch()
    os.kill(bench.copier.pid, signal.SIGSTOP)
    assert bench.copier.stdin is not None
    bench.copier.stdin.close()
    bench.journal.mapped.close()
    bench.journal.memory.close()  # as the end of the process does
    waking = subprocess.Popen(["sh", "-c", f"sleep 0.3; kill -CONT {bench.copier.pid}"])
    journal = FileJournal(path, LABELS)
    assert bench.copier.wait(60) == waking.wait(60) == 0
    journal.close()
    assert after_power_failure(path)[0] == 1


def test_a_full_disk_is_a_problem_until_it_is_freed(path: Path) -> None:
    memory = os.fdopen(os.memfd_create("journal"), "r+b", buffering=0)
    memory.truncate(16 * PAGE)
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (PAGE, before[1]))  # writes fail, as on a full disk
    try:
        journal = FileJournal(path, LABELS, memory)
        journal.start_copier(OFTEN)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert f"cannot be written to {path}" in (journal.problem or "")
    assert journal.copier is not None
    resource.prlimit(journal.copier.pid, resource.RLIMIT_FSIZE, before)
    eventually(lambda: journal.problem is None)
    resource.prlimit(journal.copier.pid, resource.RLIMIT_FSIZE, (PAGE, before[1]))
    journal.intend(0, 1)
    eventually(lambda: f"cannot be written to {path}" in (journal.problem or ""))
    resource.prlimit(journal.copier.pid, resource.RLIMIT_FSIZE, before)
    eventually(lambda: journal.problem is None)
    journal.close()


def test_a_folder_that_cannot_be_written_at_the_start_is_used_when_it_can(tmp_path: Path) -> None:
    blocked = tmp_path / "state"
    blocked.touch()
    bench = Bench(blocked / "arm.switches", OFTEN)
    bench.switch()
    assert bench.journal.problem is not None
    blocked.unlink()
    eventually(lambda: bench.journal.problem is None)
    assert after_power_failure(bench.path)[0] == 1
    bench.journal.close()
    assert after_power_failure(bench.path)[0] == 1


def test_a_disk_that_hangs_at_the_end_is_left_to_the_copier(
    path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(journal_file, "ENDING", 0.05)
    bench = Bench(path, NEVER)
    bench.switch()
    before = path.read_bytes()
    os.kill(bench.copier.pid, signal.SIGSTOP)  # as in a slow write
    bench.journal.close()
    assert f"process {bench.copier.pid} still copies them" in (bench.journal.problem or "")
    assert bench.journal.problem in caplog.text
    assert (path.read_bytes(), shared_path(path).exists()) == (before, True)
    os.kill(bench.copier.pid, signal.SIGCONT)
    assert bench.copier.wait(60) == 0
    shared_path(path).unlink()
    assert after_power_failure(path)[0] == 1


def test_a_copier_that_cannot_start_is_a_warning_and_the_end_copies(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with monkeypatch.context() as patched:
        patched.setattr(sys, "executable", "/nowhere/python")
        bench = Bench(path, OFTEN)
    assert "cannot be started" in (bench.journal.problem or "")
    bench.switch()
    bench.journal.close()
    assert after_power_failure(path)[0] == 1


def test_a_killed_copier_is_a_problem_and_the_end_copies(bench: Bench) -> None:
    os.kill(bench.copier.pid, signal.SIGKILL)
    assert "has ended" in eventually(lambda: bench.journal.problem)
    assert "has ended" in (bench.journal.problem or "")
    bench.switch()
    bench.journal.close()
    assert after_power_failure(bench.path)[0] == 1


def test_the_copier_keeps_no_file_of_the_executor_but_its_own(bench: Bench) -> None:
    bench.switch()
    eventually(lambda: after_power_failure(bench.path)[0] == 1)
    folder = Path(f"/proc/{bench.copier.pid}/fd")
    opened = sorted(os.readlink(file).split(":")[0] for file in folder.iterdir())
    assert opened == sorted(["pipe", "pipe", "/dev/null", str(shared_path(bench.path))])
    assert os.sched_getscheduler(bench.copier.pid) == os.SCHED_OTHER
    with pytest.raises(FileInUse, match=f"the switch journal {bench.path} is in use by process {os.getpid()}"):
        FileJournal(bench.path, LABELS)
    os.close(lock_file(bench.path.with_name("other"), ""))


def test_switching_calls_nothing_that_may_wait_for_a_file(bench: Bench) -> None:
    called: set[str] = set()

    def note(_frame: Any, event: str, function: Any) -> None:
        if event == "c_call":
            called.add(f"{function.__module__ or type(function.__self__).__module__}.{function.__name__}")

    bench.switch()
    sys.setprofile(note)
    try:
        bench.switch(3)
    finally:
        sys.setprofile(None)
    rooms = {name.split(".")[0] for name in called}
    assert "zlib" in rooms, "the checksum shows that calls are seen"
    assert not rooms & {"posix", "_io", "io", "fcntl", "select", "mmap", "time", "_posixsubprocess"}, called
