from __future__ import annotations

import struct
import zlib
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

from hyperbit.controller.flight_recorder.pickling import unpickle
from hyperbit.controller.host.keeper import LARGEST, LENGTH, MAGIC, RefusedFile, about

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
