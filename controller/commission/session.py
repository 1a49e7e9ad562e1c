"""The session of a commission: which actuator is next, what was seen so far, and its record beside the arm's file."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Sequence
from pathlib import Path

import msgspec
from msgspec.structs import replace

from hyperbit.controller.armfile.commissioned import (
    CommissionRecord,
    InputChange,
    Sighting,
    record_path,
    wiring_in_words,
)
from hyperbit.controller.armfile.settings import ActuatorSettings
from hyperbit.controller.commission.diagnosis import Diagnosis, diagnose
from hyperbit.controller.host.files import read_kept
from hyperbit.controller.program import Ended


class Session:
    """The commission of one arm. Each answer is on the disk before the next question.

    Sightings of actuators whose wiring in the file has changed since are forgotten: they are tried again.
    """

    def __init__(self, file: Path, arm: str, labels: Sequence[str], wired: Sequence[ActuatorSettings]) -> None:
        self.path, self._arm = record_path(file), arm
        self.entries = dict(zip(labels, wired, strict=True))
        self._wiring = {label: wiring_in_words(entry) for label, entry in self.entries.items()}
        self._names = line_names(labels, wired)
        kept = read_kept(self.path, CommissionRecord, "the commission begins again") or CommissionRecord(arm)
        same = {label for label, words in self._wiring.items() if kept.wiring.get(label) == words}
        self.sightings = [one for one in kept.sightings if {one.actuator, one.moved or one.actuator} <= same]

    @property
    def diagnosis(self) -> Diagnosis:
        return diagnose(self.entries, self.sightings)

    def todo(self) -> list[str]:
        """Returns the actuators that were not tried in both directions, by board; then pairs that must be tried again.

        A pair that moved nothing may have been at that end already: after other motions the same command tells more.
        """
        tried = {(one.actuator, one.state) for one in self.sightings}
        free = [label for label, entry in self.entries.items() if entry.stuck is None]
        found = [label for label in free if not {(label, 0), (label, 1)} <= tried]
        if not found:
            still = {one.actuator for one in self.sightings if one.moved is None and not one.again}
            found = [label for label in free if label in still and self.entries[label].output_off is not None]
        return sorted(found, key=lambda label: (self.entries[label].bus, self.entries[label].node))

    def forget(self, labels: Sequence[str]) -> None:
        """Forgets what was seen after commands to actuators: they are tried again."""
        self.sightings = [one for one in self.sightings if one.actuator not in labels]

    def sighting(self, label: str, state: int, ended: Ended) -> Sighting:
        """Returns what the inputs tell of a trial; the answer of the person is added later."""
        levels = int.from_bytes(ended.inputs, "little")
        before = {name: levels >> line & 1 for line, name in enumerate(self._names) if name}
        changes = [
            InputChange(self._names[change.line], change.level, round(change.seconds, 6))
            for change in ended.changes
            if change.line < len(self._names) and self._names[change.line]
        ]
        return Sighting(label, state, None, 0, before, changes)

    def add(self, seen: Sighting) -> None:
        """Adds a sighting, and writes the record. It replaces an earlier one, unless only that one saw a motion."""
        before = [one for one in self.sightings if (one.actuator, one.state) == (seen.actuator, seen.state)]
        if before and before[0].moved is not None and seen.moved is None:
            return
        self.sightings = [one for one in self.sightings if one not in before]
        self.sightings.append(replace(seen, again=bool(before)))
        self.save()

    def save(self) -> None:
        """Writes the record. Raises OSError if it cannot be written."""
        commissioned = {label: self._wiring[label] for label in self.diagnosis.right}
        write_whole(
            self.path,
            msgspec.json.format(
                msgspec.json.encode(CommissionRecord(self._arm, commissioned, self._wiring, self.sightings)), indent=1
            ),
        )


def line_names(labels: Sequence[str], wired: Sequence[ActuatorSettings]) -> list[str]:
    """Returns the name of each input line of the executor's wiring; "" without an input. Interlocks follow, unnamed."""
    first = [f"{label}.input" if entry.input is not None else "" for label, entry in zip(labels, wired, strict=True)]
    ended = [(label, entry) for label, entry in zip(labels, wired, strict=True) if entry.input_contracted is not None]
    return first + [f"{label}.input_contracted" for label, _ in ended]


def write_whole(path: Path, data: bytes) -> None:
    """Replaces a file by a whole new one, also when the power fails. Raises OSError if it cannot be written."""
    draft = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        with draft.open("wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        draft.replace(path)
    except OSError:
        with contextlib.suppress(OSError):
            draft.unlink()
        raise
    folder = os.open(path.parent, os.O_RDONLY)
    try:
        os.fsync(folder)
    finally:
        os.close(folder)
