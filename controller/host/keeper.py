"""The keeper: a process that copies its parent's memory to the disk, so that no disk delays the parent.

A write to a disk can take seconds, and a thread would take the interpreter's lock from the parent's loop. The keeper is
started as `python -I -S keeper.py`, so this file imports the standard library only. The keeper survives the signals of
a service manager or a terminal. It ends after its parent, even a killed one, and saves a last time then.

The job `copy` copies a file with one writer to the disk. The job `events` saves the last events of a core. The flight
recorder writes them to two files in memory, the generations. Each begins with a line of JSON and a pickle of the
core, the checkpoint. Blocks of entries follow, each a length and a pickle. A new generation replaces the older of the
two. So together they have the last events, and a state from which these can be replayed. A saved file has MAGIC, a line
of JSON, and both generations in zlib.
"""

from __future__ import annotations

import contextlib
import errno
import fcntl
import json
import os
import re
import select
import signal
import stat
import struct
import subprocess
import sys
import time
import zlib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import IO, Any

MAGIC = b"hyperbit events 1\n"
SHARED = Path("/dev/shm")  # a file system in memory
LENGTH = struct.Struct("<I")
LARGEST = 1 << 28  # bytes of an unpacked file
AT_MOST_EVERY = 60.0  # [s] between two saved files of a process
SAME_CAUSE_EVERY = 3600.0  # [s] between two files of one cause: a recurring fault is saved a few times a night
KINDS = ("executor", "planner")
ARM = re.compile(r"[A-Za-z0-9_-]{1,64}")
NUMBER = re.compile(r"Z(?:-.*)?-(\d+)\Z")  # of a file, after its time
KEPT = 10  # saved files of an arm's process; the oldest ones are deleted
RETRY = 0.02  # [s] between two attempts to lock a file
LOOK_EVERY = 1.0  # [s] between two looks whether the file on the disk is still there
GONE = b"was deleted or moved, and is written again"
LONGEST_LINE = 1_000  # bytes of a message of the copying keeper; a pipe takes 4,096 at once


REMEDIES = {  # by error of a file that is to be locked
    errno.EACCES: "it or its folder belongs to another user: name another folder, or start as that user",
    errno.ENOLCK: "its file system has no locks: name a folder on a local disk",
    errno.EROFS: "name a folder that can be written",
}


class FileInUse(Exception):
    """Another process has locked a file; the text names it."""


class RefusedFile(ValueError):
    """A file is no file of events, or contains forbidden objects; the text says what."""


def lock_file(path: Path, used: str, timeout: float = 0.0) -> int:
    """Opens and locks a file, writes the process id into its first line, and returns its file descriptor.

    The file is created if it does not exist. The lock lasts until the last process that shares the descriptor ends. The
    owner of the lock may delete the file.

    Args:
        used: text of the error, before the process id.
        timeout: longest time to wait for the end of another process [s].

    Raises:
        FileInUse: another process has locked the file.
        OSError: it cannot be opened or locked; the error names the file, and a remedy if there is one.
    """
    try:
        return lock(path, used, timeout)
    except OSError as error:
        number, words = error.errno or errno.EIO, [error.strerror or str(error)]
        words += [REMEDIES[number]] if number in REMEDIES else []
        raise OSError(number, "; ".join(words), error.filename or str(path)) from None


def lock(path: Path, used: str, timeout: float) -> int:
    """Does what `lock_file` does; an error need not name the file."""
    path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
    deadline = time.monotonic() + timeout
    while True:
        number = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW, 0o600)
        try:
            fcntl.flock(number, fcntl.LOCK_EX | fcntl.LOCK_NB)
            if os.fstat(number).st_nlink:  # otherwise the last owner has just deleted it
                os.pwrite(number, b"%d\n" % os.getpid(), 0)
                return number
        except BlockingIOError:
            if time.monotonic() >= deadline:
                pid = os.pread(number, 32, 0).split(b"\n")[0].decode(errors="replace") or "unknown"
                os.close(number)
                raise FileInUse(f"{used} {pid}") from None
            time.sleep(RETRY)
        except OSError:
            os.close(number)
            raise
        os.close(number)


def number_of(name: str) -> int:
    """Returns the number at the end of a file's name, or 0. The numbers tell the order, also if the clock was set."""
    found = NUMBER.search(name)
    return 0 if found is None else int(found[1])


@contextlib.contextmanager
def whole_file(path: Path, *, sync: bool = True) -> Iterator[IO[bytes]]:
    """Yields a file to write, which then replaces another one. After a failure, also of the power, the old one stays.

    Only the same user can read the file. Without `sync` nobody waits for the disk, and a failure of the power can leave
    an empty file.

    Raises:
        OSError: it cannot be written.
    """
    path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
    partial = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        with os.fdopen(os.open(partial, os.O_RDWR | os.O_CREAT | os.O_TRUNC | os.O_NOFOLLOW, 0o600), "w+b") as file:
            yield file
            file.flush()
            if sync:
                os.fsync(file.fileno())
        partial.replace(path)
    except BaseException:
        partial.unlink(missing_ok=True)
        raise
    if not sync:
        return
    folder = os.open(path.parent, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(folder)  # writes the name to the disk
    finally:
        os.close(folder)


def write_whole(path: Path, content: bytes, *, sync: bool = True) -> None:
    """Replaces a file as `whole_file` does."""
    with whole_file(path, sync=sync) as file:
        file.write(content)


def start_keeper(job: str, *arguments: object, files: Sequence[int] = ()) -> subprocess.Popen[bytes]:
    """Starts a keeper with the job "copy" or "events", and pipes that do not block. May raise OSError."""
    command = [sys.executable, "-I", "-S", __file__, job, *map(str, arguments)]
    told = subprocess.PIPE if job == "copy" else subprocess.DEVNULL
    errors = subprocess.DEVNULL if job == "copy" else None
    before = signal.pthread_sigmask(signal.SIG_BLOCK, signal.valid_signals())  # the process inherits the mask
    try:
        started = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=told, stderr=errors, pass_fds=files)
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
    for pipe in filter(None, (started.stdin, started.stdout)):
        os.set_blocking(pipe.fileno(), False)
    return started


def copy(memory: int, path: Path, interval: float) -> None:
    """Copies a changed file in memory to the disk, each `interval` [s], and when the standard input ends.

    A file on the disk that somebody deletes or moves is written again within a second.

    The standard output has a line for each change: why the last copy failed, GONE, or an empty line after a success.
    `memory` is the descriptor of the file in memory.
    """
    told, copied, ended, there, due = None, b"", False, path.exists(), time.monotonic() + interval
    while not ended:
        ended = bool(select.select([0], [], [], min(interval, LOOK_EVERY))[0])
        before, there = there, path.exists()
        gone = before and not there
        if not (ended or gone) and time.monotonic() < due:
            continue
        due = time.monotonic() + interval
        content, problem = os.pread(memory, os.fstat(memory).st_size, 0), GONE if gone else b""
        try:
            if ended or gone or content != copied:
                write_whole(path, content)
            copied = content
        except OSError as error:
            problem = " ".join(str(error).split()).encode(errors="replace")[:LONGEST_LINE]
        if problem != told:
            with contextlib.suppress(OSError):  # the parent has been killed
                os.write(1, problem + b"\n")
        told = problem


def ring_paths(arm: str, kind: str, pid: int) -> tuple[Path, Path]:
    first, second = (SHARED / f"hyperbit-{os.getuid()}-{arm}-{kind}-{pid}.{n}.events" for n in range(2))
    return first, second


def read_generation(path: Path) -> bytes:
    """Returns a generation in memory; b"" if it is not there. Raises OSError if it cannot be read."""
    with contextlib.suppress(FileNotFoundError):
        file = os.open(path, os.O_RDONLY | os.O_CLOEXEC | os.O_NOFOLLOW | os.O_NONBLOCK)
        with os.fdopen(file, "rb") as opened:
            if stat.S_ISREG(os.fstat(file).st_mode):
                return opened.read(LARGEST)
    return b""


def about(content: bytes) -> dict[str, Any]:
    """Returns the line of JSON at the beginning of a generation.

    Raises RefusedFile if there is none, or its values are wrong: its arm and kind become names of files.
    """
    try:
        found: dict[str, Any] = json.loads(content[: content.index(b"\n")])
        words = found["arm"], found["kind"]
        numbers = found["number"], found["checkpoint"]
        fit = ARM.fullmatch(words[0]) and words[1] in KINDS and all(type(n) is int and n >= 0 for n in numbers)
    except (ValueError, KeyError, TypeError) as error:
        raise RefusedFile(f"the beginning of a generation cannot be read: {error}") from None
    if not fit:
        raise RefusedFile(f"the beginning of a generation has wrong values: {words}, {numbers}")
    return found


def save(paths: Sequence[Path], folder: Path, cause: str, kept: int | None = None) -> Path:
    """Saves the generations of one process as a file; returns its path. Only the same user can read the file.

    Args:
        paths: of the generations in memory.
        folder: of the file.
        cause: for its name.
        kept: most files of this arm and kind; the oldest ones are deleted. None: no limit.

    Raises:
        OSError: a file cannot be read or written, or nothing was recorded.
        RefusedFile: a generation is damaged.
    """
    found = sorted((about(content)["number"], content) for content in map(read_generation, paths) if content)
    if not found:
        raise FileNotFoundError("no events are recorded")
    last = about(found[-1][1])
    start = f"{last['arm']}.events-"
    stamp, word = time.strftime("%Y%m%dT%H%M%SZ", time.gmtime()), re.sub(r"[^a-z0-9]+", "-", cause.lower())
    own = re.compile(re.escape(start) + rf"\d{{8}}T\d{{6}}Z-{last['kind']}-")
    others = sorted((number_of(it.name), it) for it in folder.glob(f"{start}*") if own.match(it.name))
    number = others[-1][0] + 1 if others else 1
    path = folder / f"{start}{stamp}-{last['kind']}-{word.strip('-')[:40]}-{number}"
    head = json.dumps({"cause": cause, "saved": time.time()}).encode() + b"\n"
    parts = b"".join(LENGTH.pack(len(content)) + content for _, content in found)
    write_whole(path, MAGIC + head + zlib.compress(parts))
    for _, old in others[: max(len(others) + 1 - (kept or sys.maxsize), 0)]:
        old.unlink(missing_ok=True)
    return path


def keep(paths: Sequence[Path], folder: Path) -> None:
    """Saves the events for each line of the standard input, which names the cause, and after a kill of the process.

    A line "end" ends the keeper. At the end the files in memory are deleted.
    """
    last, saved = -AT_MOST_EVERY, dict[str, float]()
    cause = ""
    while cause not in ("end", "killed"):
        for line in (os.read(0, 4096) or b"killed").splitlines():
            cause, now = line.decode(errors="replace"), time.monotonic()
            early = now < last + AT_MOST_EVERY or now < saved.get(cause, -SAME_CAUSE_EVERY) + SAME_CAUSE_EVERY
            if cause == "end" or (early and cause != "killed"):
                continue
            last = saved[cause] = now
            try:
                text = f"the last events are in {save(paths, folder, cause, KEPT)}"
            except (OSError, RefusedFile) as error:
                text = f"the last events cannot be saved: {error}"
            with contextlib.suppress(OSError):
                os.write(2, f"{text} ({cause})\n".encode())
    for path in paths:
        with contextlib.suppress(OSError):  # the file system in memory can be read only
            path.unlink(missing_ok=True)


def reopen_errors() -> None:
    """Opens the standard error again if it is a pipe or terminal, so that no reader holds up the keeper."""
    mode = os.fstat(2).st_mode
    if stat.S_ISFIFO(mode) or stat.S_ISCHR(mode):
        with contextlib.suppress(OSError):  # it belongs to another user, or nobody reads it
            os.dup2(os.open("/proc/self/fd/2", os.O_WRONLY | os.O_NONBLOCK | os.O_NOCTTY), 2)


if __name__ == "__main__":
    with contextlib.suppress(OSError):  # the unit may let children inherit the executor's real-time priority
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    if sys.argv[1] == "copy":
        copy(int(sys.argv[2]), Path(sys.argv[3]), float(sys.argv[4]))
    else:
        os.nice(5)
        reopen_errors()
        keep([Path(word) for word in sys.argv[3:]], Path(sys.argv[2]))
