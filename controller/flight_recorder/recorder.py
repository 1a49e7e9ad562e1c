"""The flight recorder: the last events of a pure core, with a state from which they can be replayed.

Nothing here waits: entries go to a file in memory, and a process of normal priority saves them on a disk. See `keeper`
for both files, and `tests.simulation.events` for the replay.
"""

from __future__ import annotations

import contextlib
import copyreg
import io
import json
import logging
import os
import pickle
import re
import subprocess
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import FunctionType, MappingProxyType, MethodType
from typing import IO, Any, NamedTuple

from msgspec import UnsetType

from hyperbit.controller.host.keeper import LENGTH, SHARED, RefusedFile, ring_paths, start_keeper

log = logging.getLogger(__name__)

WANTED = 5_000  # events after a checkpoint; then the next one is taken as soon as `may_checkpoint` permits
MOST = 20_000  # events of a generation; then the next one begins, even without a checkpoint
ENDING = 1.0  # [s] for the end of the keeper
# What a pickle of events may contain: classes of these modules, which only hold data and compute.
PURE = re.compile(
    r"hyperbit\.controller\.(armfile\.settings|host\.process|messages\.(arm|goals|parts|state)|program(\.\w+)?"
    r"|(manipulator|motion(\.\w+)?|obstacles|planning\.core|refusals)\.\w+)"
    r"|hyperbit\.controller\.executor\.(arm|core|motion)\.\w+"
    r"|hyperbit\.drivers\.canopen\.((boards|boot|run|sdo)\.\w+|faults|layout|pdo|status|wiring|wire\.(cia301|events|link))"
)
LEFT_OUT = "left out"  # replaces an opaque value that is not None


class Label(NamedTuple):
    """The recorded core and its arm."""

    kind: str  # "executor" or "planner"
    arm: str
    digest: str  # SHA-256 of the arm's file
    file: str = ""  # text of the arm's file, for a core that refers to objects made from it


class FlightRecorder:
    """Records each step of a core: call `begin` before the first step, and the recorder itself after each step.

    As a context, it saves the events if an exception ends the process.

    Args:
        folder: of saved files; None: nothing is saved by itself.
        opaque: field of a class that is omitted, because the core only tests whether it is None.
        outside: constant objects that are recorded by name, such as the manipulator; the only ones of their types.
        batch: number of entries after which they are written; a caller with a larger one calls `flush`.
    """

    def __init__(
        self,
        label: Label,
        folder: Path | None,
        opaque: Mapping[type, str] = MappingProxyType({}),
        outside: Mapping[str, object] = MappingProxyType({}),
        batch: int = 1,
    ) -> None:
        self._label, self._batch = label, batch
        self._core: Any = None
        self._may_checkpoint: Callable[[int], bool] = bool
        self._table = reducers(opaque, outside)
        self.paths = ring_paths(label.arm, label.kind, os.getpid())  # of the two files in memory
        self._pending: list[tuple[Any, float, float | None, list[Any] | None]] = []
        self._file: IO[bytes] | None = None
        self._number = self._count = 0
        self._tried = 0  # number of events at the last attempt to take a checkpoint
        self._unpicklable = False
        self._keeper: subprocess.Popen[bytes] | None = None
        try:
            _remove_left(label)
            if folder is not None:
                self._keeper = start_keeper("events", folder.absolute(), *self.paths)
        except OSError as error:
            self._stop(error)

    def begin(self, core: Any, may_checkpoint: Callable[[int], bool]) -> None:
        """Begins to record the steps of a core.

        Args:
            core: pure; picklable now, and whenever `may_checkpoint` returns True.
            may_checkpoint: takes the number of events since the last checkpoint; returns whether the core may be
                pickled now, which takes 1 to 2 ms.
        """
        self.flush()
        self._core, self._may_checkpoint = core, may_checkpoint
        try:
            self._begin(self._checkpoint())
        except OSError as error:
            self._stop(error)

    def __call__(self, event: Any, now: float, wall: float | None, actions: Sequence[Any] | None) -> None:
        """Records a step; `wall`: UNIX time [s], if the core takes it; `actions`: None after an exception."""
        if self._file is None:
            return
        self._pending.append((event, now, wall, None if actions is None else list(actions)))
        if actions is None or len(self._pending) >= self._batch:
            self.flush()

    def flush(self) -> None:
        """Writes the recorded steps to memory; takes a checkpoint if one is due; has a fault saved."""
        if self._file is None or not self._pending:
            return
        entries, self._pending = self._pending, []
        try:
            block = self._pickled(entries)
            self._file.write(LENGTH.pack(len(block)) + block)
            self._count += len(entries)
            cause = next(filter(None, map(_cause, entries)), None)
            if cause is not None:
                self.save(cause)
            elif self._count >= self._tried + WANTED and self._may_checkpoint(self._count):
                self._tried = self._count
                if checkpoint := self._checkpoint():
                    self._begin(checkpoint)
            if self._count >= MOST:
                self._begin(b"")
        except Exception as error:  # a recorder must not stop the arm
            self._stop(error)

    def save(self, cause: str) -> None:
        """Makes the keeper save the events, unless it did so a moment ago."""
        if self._keeper is not None and self._keeper.stdin is not None:
            with contextlib.suppress(OSError):  # the keeper has ended, or is slow
                os.write(self._keeper.stdin.fileno(), cause.encode()[:200] + b"\n")

    def close(self) -> None:
        self.flush()
        self.save("end")
        if self._keeper is not None and self._keeper.stdin is not None:
            self._keeper.stdin.close()
            with contextlib.suppress(subprocess.TimeoutExpired):
                self._keeper.wait(ENDING)
        self._stop()

    def __enter__(self) -> FlightRecorder:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if kind is not None and issubclass(kind, Exception):
            self.flush()
            self.save("exception")
        self.close()

    def _checkpoint(self) -> bytes:
        try:
            return self._pickled(self._core)
        except Exception as error:
            level = logging.DEBUG if self._unpicklable else logging.WARNING  # once, not every few seconds
            self._unpicklable = True
            log.log(level, "no checkpoint of the %s for the recorded events: %s", self._label.kind, error)
            return b""

    def _pickled(self, content: Any) -> bytes:
        buffer = io.BytesIO()
        pickler = pickle.Pickler(buffer, 5)
        pickler.dispatch_table = self._table
        pickler.dump(content)
        return buffer.getvalue()

    def _begin(self, checkpoint: bytes) -> None:
        path = self.paths[self._number % 2]
        about = {
            **self._label._asdict(),
            "number": self._number,
            "pid": os.getpid(),
            "monotonic": time.monotonic(),
            "wall": time.time(),
            "checkpoint": len(checkpoint),
        }
        path.unlink(missing_ok=True)
        number = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC | os.O_NOFOLLOW, 0o600)
        before, self._file = self._file, os.fdopen(number, "wb", buffering=0)
        if before is not None:
            before.close()
        self._file.write(json.dumps(about).encode() + b"\n" + checkpoint)
        self._number += 1
        self._count = self._tried = 0

    def _stop(self, error: Exception | None = None) -> None:
        if error is not None:
            log.warning("events of the %s are not recorded: %s: %s", self._label.kind, type(error).__name__, error)
        file, self._file = self._file, None
        if file is not None:
            file.close()
        for path in self.paths:
            with contextlib.suppress(OSError):
                path.unlink(missing_ok=True)


def _cause(entry: tuple[Any, float, float | None, list[Any] | None]) -> str | None:
    """Returns why to save events at this step: an exception, or a logged error; otherwise None."""
    actions = entry[3]
    if actions is None:
        return "exception"
    for action in actions:
        if getattr(action, "level", 0) >= logging.ERROR:
            return str(action.fields.get("HYPERBIT_FAULT", "error"))
    return None


def _remove_left(label: Label) -> None:
    """Removes the files in memory of ended processes."""
    for path in SHARED.glob(f"hyperbit-{os.getuid()}-{label.arm}-{label.kind}-*.events"):
        pid = path.name.rsplit("-", 1)[1].split(".")[0]
        if pid.isdecimal():
            try:
                os.kill(int(pid), 0)
            except ProcessLookupError:
                path.unlink(missing_ok=True)
            except OSError:
                pass  # it belongs to another user now


# --- pickles; one could call any function, so a reader accepts only data, and classes without side effects


def reducers(opaque: Mapping[type, str], outside: Mapping[str, object]) -> dict[type, Callable[[Any], Any]]:
    """Returns a Pickler's reducers for objects that pickle refuses, or would look up by `getattr`."""
    names = {id(it): name for name, it in outside.items()}

    def without(field: str) -> Callable[[Any], Any]:
        def reduced(it: Any) -> Any:
            stands = None if getattr(it, field) is None else LEFT_OUT
            if isinstance(it, tuple):  # a NamedTuple
                return type(it), tuple(it._replace(**{field: stands}))  # type: ignore[attr-defined]
            return copyreg.__newobj__, (type(it),), vars(it) | {field: stands}  # type: ignore[attr-defined]

        return reduced

    def by_name(it: object) -> Any:
        if id(it) not in names:
            raise pickle.PicklingError(f"it has another {type(it).__name__} than {', '.join(outside)}")
        return stands_outside, (names[id(it)],)

    table: dict[type, Callable[[Any], Any]] = dict(copyreg.dispatch_table)
    table[MethodType] = lambda method: (method_of, (method.__self__, method.__name__))
    table[MappingProxyType] = lambda mapping: (dict, (dict(mapping),))
    table[UnsetType] = lambda unset: (UnsetType, ())  # by its name, pickle would look for it in all modules
    table |= {type(it): by_name for it in outside.values()}
    return table | {kind: without(field) for kind, field in opaque.items()}


def method_of(owner: object, name: str) -> MethodType:
    """Returns a method of an object of a pure module; pickles of bound methods call this."""
    function = next((vars(kind)[name] for kind in type(owner).__mro__ if name in vars(kind)), None)
    if not isinstance(function, FunctionType) or not PURE.fullmatch(function.__module__):
        raise RefusedFile(f"the file contains a method {name!r} of {type(owner).__name__}: it is not loaded")
    return MethodType(function, owner)


def stands_outside(name: str) -> Any:
    """Replaces, in a pickle, an object that is recorded by name. `load` gets the object itself."""
    raise RefusedFile(f"{name!r} was not given")
