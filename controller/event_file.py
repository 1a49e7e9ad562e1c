"""Files of the last events of a process's core, see `FlightRecorder`, and the keeper, a process that saves them.

The process writes its events to two files in memory, the generations. Each begins with a line of JSON and a pickle of
the core, the checkpoint. Blocks of entries follow, each a length and a pickle. A newer generation replaces the older of
the two, so that together they have the last events, and a state from which these can be replayed.

The keeper has normal priority, so that no disk delays the process. It is started as `python -I -S event_file.py`:
this file imports the standard library only. A saved file has MAGIC, a line of JSON, and both generations in zlib.
"""

from __future__ import annotations

import contextlib
import importlib
import io
import json
import os
import pickle
import re
import stat
import struct
import sys
import time
import zlib
from collections.abc import Sequence
from pathlib import Path
from types import FunctionType, MethodType
from typing import Any, NamedTuple

MAGIC = b"hyperbit events 1\n"
SHARED = Path("/dev/shm")  # a file system in memory
LENGTH = struct.Struct("<I")
LARGEST = 1 << 28  # bytes of an unpacked file
AT_MOST_EVERY = 60.0  # [s] between two saved files of a process
SAME_CAUSE_EVERY = 3600.0  # [s] between two files of one cause: a fault that comes back all night is saved a few times
KINDS = ("executor", "planner")
ARM = re.compile(r"[A-Za-z0-9_-]{1,64}")
KEPT = 10  # saved files of an arm's process; the oldest ones are deleted

# What a pickle of events may contain: classes of these modules, which only hold data and compute.
PURE = re.compile(
    r"controller\.(settings|program(\.\w+)?|motion\.\w+|obstacles\.\w+|planning\.core\.\w+)"
    r"|controller\.executor\.(actuation|arm|clearance|clients|core|ending|events|kinds|locked|modes|motion"
    r"|motion_supervision|program_execution|reports|requests|results|setpoint_stream|travel_times)"
    r"|drivers\.canopen\.((boot|run|sdo)\.\w+|faults|layout|pdo|status|wiring|wire\.(cia301|events|link|load|tx_echo))"
)
OTHERS = {
    ("controller.event_file", "method_of"),
    ("controller.executor.switch_journal", "MemoryJournal"),
    ("collections", "Counter"),
    ("collections", "OrderedDict"),
    ("collections", "defaultdict"),
    ("collections", "deque"),
    ("functools", "partial"),
    *(("builtins", name) for name in ("bytearray", "complex", "dict", "frozenset", "list", "range", "set", "slice")),
    *(("numpy", name) for name in ("dtype", "ndarray")),
    *((f"numpy.{core}.multiarray", name) for core in ("core", "_core") for name in ("_reconstruct", "scalar")),
    *((f"numpy.{core}.numeric", "_frombuffer") for core in ("core", "_core")),
}


class Refused(ValueError):
    """A file is no file of events, or contains what such a file may not contain; the text says what."""


class Entry(NamedTuple):
    """One step of the core.

    Attributes:
        event: that the core took.
        now: CLOCK_MONOTONIC [s].
        wall: UNIX time [s]; None for a core that takes none.
        actions: that the core returned; None: the step raised an exception.
    """

    event: Any
    now: float
    wall: float | None
    actions: list[Any] | None


class Generation(NamedTuple):
    """A part of the events.

    Attributes:
        about: line of JSON: arm, kind, digest of the arm's file, version of hyperbit, pid, number, times.
        core: at the checkpoint, before the first entry; None: no checkpoint could be taken.
        entries: the steps since then.
    """

    about: dict[str, Any]
    core: Any
    entries: list[Entry]


def ring_paths(arm: str, kind: str, pid: int) -> tuple[Path, Path]:
    """Returns the paths of the two generations of a process in memory."""
    first, second = (SHARED / f"hyperbit-{os.getuid()}-{arm}-{kind}-{pid}.{n}.events" for n in range(2))
    return first, second


def read_generation(path: Path) -> bytes:
    """Returns a generation in memory; b"" if it is not there.

    Raises:
        OSError: it cannot be read.
    """
    with contextlib.suppress(FileNotFoundError):
        file = os.open(path, os.O_RDONLY | os.O_CLOEXEC | os.O_NOFOLLOW | os.O_NONBLOCK)
        with os.fdopen(file, "rb") as opened:
            if stat.S_ISREG(os.fstat(file).st_mode):
                return opened.read(LARGEST)
    return b""


def about(content: bytes) -> dict[str, Any]:
    """Returns the line of JSON at the beginning of a generation.

    Raises:
        Refused: there is none, or it has other values than a process writes: its arm and kind become names of files.
    """
    try:
        found: dict[str, Any] = json.loads(content[: content.index(b"\n")])
        words = found["arm"], found["kind"]
        numbers = found["number"], found["checkpoint"]
        fit = ARM.fullmatch(words[0]) and words[1] in KINDS and all(type(n) is int and n >= 0 for n in numbers)
    except (ValueError, KeyError, TypeError) as error:
        raise Refused(f"the beginning of a generation cannot be read: {error}") from None
    if not fit:
        raise Refused(f"the beginning of a generation has wrong values: {words}, {numbers}")
    return found


def save(paths: Sequence[Path], folder: Path, cause: str, kept: int | None = None) -> Path:
    """Saves the generations of one process as a file.

    Args:
        paths: of the generations in memory.
        folder: of the file.
        cause: for its name.
        kept: most files of this arm and kind; the oldest ones are deleted. None: no limit.

    Returns:
        Path of the file, readable by the same user only.

    Raises:
        OSError: a file cannot be read or written, or nothing was recorded.
        Refused: a generation is damaged.
    """
    found = sorted((about(content)["number"], content) for content in map(read_generation, paths) if content)
    if not found:
        raise FileNotFoundError("no events are recorded")
    last = about(found[-1][1])
    start = f"{last['arm']}.events-"
    stamp, word = time.strftime("%Y%m%dT%H%M%SZ", time.gmtime()), re.sub(r"[^a-z0-9]+", "-", cause.lower())
    folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    path = folder / f"{start}{stamp}-{last['kind']}-{word.strip('-')[:40]}"
    head = json.dumps({"cause": cause, "saved": time.time()}).encode() + b"\n"
    parts = b"".join(LENGTH.pack(len(content)) + content for _, content in found)
    partial = path.with_name(f".{path.name}.{os.getpid()}")
    with os.fdopen(os.open(partial, os.O_WRONLY | os.O_CREAT | os.O_TRUNC | os.O_NOFOLLOW, 0o600), "wb") as file:
        file.write(MAGIC + head + zlib.compress(parts))
    if path.exists():  # of another process of the same arm, in the same second
        path = path.with_name(f"{path.name}-{last.get('pid', os.getpid())}")
    partial.replace(path)
    own = re.compile(re.escape(start) + rf"\d{{8}}T\d{{6}}Z-{last['kind']}-")
    for old in sorted(other for other in folder.iterdir() if own.match(other.name))[: -(kept or sys.maxsize)]:
        old.unlink(missing_ok=True)
    return path


def load(path: Path) -> list[Generation]:
    """Reads a saved file. Only data and classes without side effects are accepted.

    Raises:
        Refused: the file is damaged, no file of events, or contains anything else.
        OSError: the file cannot be read.
    """
    content = path.read_bytes()
    if not content.startswith(MAGIC):
        raise Refused(f"{path} is no file of events of this version: it does not begin with {MAGIC.decode().strip()!r}")
    unpacking = zlib.decompressobj()
    try:
        parts = unpacking.decompress(content[content.index(b"\n", len(MAGIC)) + 1 :], LARGEST)
        generations = []
        while parts:
            (size,) = LENGTH.unpack_from(parts)
            generations.append(_generation(parts[LENGTH.size : LENGTH.size + size]))
            parts = parts[LENGTH.size + size :]
    except (zlib.error, struct.error, ValueError) as error:
        raise error if isinstance(error, Refused) else Refused(f"{path} is damaged: {error}") from None
    return generations


def _generation(content: bytes) -> Generation:
    said = about(content)
    place = content.index(b"\n") + 1
    core = unpickle(content[place : place + said["checkpoint"]]) if said["checkpoint"] else None
    place += said["checkpoint"]
    entries: list[Entry] = []
    while place + LENGTH.size <= len(content):
        (size,) = LENGTH.unpack_from(content, place)
        place += LENGTH.size
        if place + size > len(content):
            break  # the process was killed while it wrote this block
        entries += [Entry(*entry) for entry in unpickle(content[place : place + size])]
        place += size
    return Generation(said, core, entries)


class _Unpickler(pickle.Unpickler):
    def find_class(self, module: str, name: str) -> Any:
        if (module, name) in OTHERS:
            return getattr(importlib.import_module(module), name)
        if PURE.fullmatch(module):
            found = getattr(importlib.import_module(module), name, None)
            if isinstance(found, type) and found.__module__ == module:
                return found
        raise Refused(f"the file contains {module}.{name}, which no file of events may contain: it is not loaded")


def unpickle(content: bytes) -> Any:
    """Returns the content of a pickle of data, without code.

    Raises:
        Refused: the pickle is damaged, or contains anything else.
    """
    try:
        return _Unpickler(io.BytesIO(content)).load()
    except Refused:
        raise
    except Exception as error:
        raise Refused(f"a pickle cannot be read: {type(error).__name__}: {error}") from None


def method_of(owner: object, name: str) -> MethodType:
    """Returns a method of an object of a pure module; the form in which a pickle has bound methods."""
    function = next((vars(kind)[name] for kind in type(owner).__mro__ if name in vars(kind)), None)
    if not isinstance(function, FunctionType) or not PURE.fullmatch(function.__module__):
        raise Refused(f"the file contains a method {name!r} of {type(owner).__name__}: it is not loaded")
    return MethodType(function, owner)


def keep(paths: Sequence[Path], folder: Path) -> None:
    """Saves the events for each line of the standard input, which names the cause, and when the process was killed.

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
            except (OSError, Refused) as error:
                text = f"the last events cannot be saved: {error}"
            with contextlib.suppress(OSError):
                os.write(2, f"{text} ({cause})\n".encode())
    for path in paths:
        path.unlink(missing_ok=True)


if __name__ == "__main__":
    with contextlib.suppress(OSError):  # of a real-time executor whose unit lets children inherit its priority
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    keep([Path(word) for word in sys.argv[2:]], Path(sys.argv[1]))
