"""Reads a file of events that a flight recorder has saved."""

from __future__ import annotations

import importlib
import io
import pickle
import struct
import zlib
from collections.abc import Callable, Mapping
from pathlib import Path
from types import FunctionType, MappingProxyType
from typing import Any, NamedTuple

from hyperbit.controller.flight_recorder import recorder
from hyperbit.controller.flight_recorder.recorder import PURE, stands_outside
from hyperbit.controller.host.keeper import LARGEST, LENGTH, MAGIC, RefusedFile, about

CORE = "hyperbit.controller.planning.core."  # its functions are pure, too
OTHERS = {
    ("hyperbit.controller.flight_recorder.recorder", "method_of"),
    ("collections", "Counter"),
    ("collections", "OrderedDict"),
    ("collections", "defaultdict"),
    ("collections", "deque"),
    ("functools", "partial"),
    ("filterpy.kalman.kalman_filter", "KalmanFilter"),
    ("numpy.linalg", "inv"),  # attribute of the filter
    ("msgspec", "UnsetType"),
    ("msgspec._utils", "rebuild"),  # structs whose fields are keywords
    *(
        ("builtins", name)
        for name in ("bytearray", "complex", "dict", "frozenset", "int", "list", "range", "set", "slice")
    ),
    *(("numpy", name) for name in ("dtype", "ndarray")),
    *((f"numpy.{core}.multiarray", name) for core in ("core", "_core") for name in ("_reconstruct", "scalar")),
    *((f"numpy.{core}.numeric", "_frombuffer") for core in ("core", "_core")),
}

# From the line of JSON of a generation: returns the objects that are recorded by name.
Given = Callable[[Mapping[str, Any]], Mapping[str, Any]]


class RecordedStep(NamedTuple):
    event: Any
    now: float  # CLOCK_MONOTONIC [s]
    wall: float | None  # UNIX time [s]; None for a core without it
    actions: list[Any] | None  # None: the step raised an exception


class Generation(NamedTuple):
    """A part of the events."""

    about: dict[str, Any]  # line of JSON: arm, kind, digest of the arm's file, version of hyperbit, pid, number, times
    core: Any  # at the checkpoint, before the first entry; None: no checkpoint could be taken
    entries: list[RecordedStep]  # the steps since then


def load(path: Path, given: Given = lambda about: {}) -> list[Generation]:
    """Reads a saved file. Raises RefusedFile if it is damaged, or contains anything but events; may raise OSError."""
    content = path.read_bytes()
    if not content.startswith(MAGIC):
        raise RefusedFile(
            f"{path} is no file of events of this version: it does not begin with {MAGIC.decode().strip()!r}"
        )
    unpacking = zlib.decompressobj()
    try:
        parts = unpacking.decompress(content[content.index(b"\n", len(MAGIC)) + 1 :], LARGEST)
        generations = []
        while parts:
            (size,) = LENGTH.unpack_from(parts)
            generations.append(_generation(parts[LENGTH.size : LENGTH.size + size], given))
            parts = parts[LENGTH.size + size :]
    except (zlib.error, struct.error, ValueError) as error:
        raise error if isinstance(error, RefusedFile) else RefusedFile(f"{path} is damaged: {error}") from None
    return generations


def _generation(content: bytes, given: Given) -> Generation:
    said = about(content)
    others = given(said)
    place = content.index(b"\n") + 1
    core = unpickle(content[place : place + said["checkpoint"]], others) if said["checkpoint"] else None
    place += said["checkpoint"]
    entries: list[RecordedStep] = []
    while place + LENGTH.size <= len(content):
        (size,) = LENGTH.unpack_from(content, place)
        place += LENGTH.size
        if place + size > len(content):
            break  # the process was killed while it wrote this block
        entries += [RecordedStep(*entry) for entry in unpickle(content[place : place + size], others)]
        place += size
    return Generation(said, core, entries)


class _Unpickler(pickle.Unpickler):
    def __init__(self, content: bytes, given: Mapping[str, Any]) -> None:
        super().__init__(io.BytesIO(content))
        self._given = given

    def find_class(self, module: str, name: str) -> Any:
        if (module, name) == (recorder.__name__, stands_outside.__name__):
            return self._outside
        if (module, name) in OTHERS:
            return getattr(importlib.import_module(module), name)
        if PURE.fullmatch(module):
            found = getattr(importlib.import_module(module), name, None)
            pure = isinstance(found, type) or (isinstance(found, FunctionType) and module.startswith(CORE))
            if pure and found.__module__ == module:
                return found
        raise RefusedFile(f"the file contains {module}.{name}, which no file of events may contain: it is not loaded")

    def _outside(self, name: str) -> Any:
        if name not in self._given:
            raise RefusedFile(
                f"the core needs {name!r}, which is not in the file: it can only be made from the arm's file"
            )
        return self._given[name]


def unpickle(content: bytes, given: Mapping[str, Any] = MappingProxyType({})) -> Any:
    """Unpickles data without code; `given`: objects recorded by name. Raises RefusedFile for any other pickle."""
    try:
        return _Unpickler(content, given).load()
    except RefusedFile:
        raise
    except Exception as error:
        raise RefusedFile(f"a pickle cannot be read: {type(error).__name__}: {error}") from None
