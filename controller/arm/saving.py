"""Writes an arm's file: the fields that differ from their defaults, with tables written out."""

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from msgspec import NODEFAULT, Struct, structs

from hyperbit.controller.arm.arm import Arm, load
from hyperbit.controller.arm.tables import read_table
from hyperbit.controller.armfile.locks import STATES
from hyperbit.controller.armfile.strict import InputFaults
from hyperbit.controller.manipulator import frames
from hyperbit.controller.manipulator.locked import LockedStates

Fields = dict[str, Any]


class CannotLock(ValueError):
    """Locked actuators are a field of the wiring, and the arm has none."""


def fields_of(arm: Arm, locked: LockedStates) -> Fields:
    """Returns the fields of an arm's file as plain values; locked actuators (A,) are `stuck`.

    Raises:
        CannotLock: other actuators are locked than in the arm's file, and it maps none to boards.
        InputFaults: a table beside the arm's file cannot be read.
    """
    settings = arm.settings
    if not arm.wiring and (locked >= 0).any():
        raise CannotLock("the file names locked actuators by their wiring, and this arm has none: unlock them")
    if arm.wiring:
        held = [None if state < 0 else STATES[state] for state in locked.tolist()]
        wiring = [structs.replace(entry, stuck=state) for entry, state in zip(arm.wiring, held, strict=True)]
        settings = structs.replace(settings, actuators=wiring, wiring=None)
    fields: Fields = plain(settings)
    path, faults = arm.path or Path(), list[str]()
    fields["modules"] = listed(fields["modules"], path.parent, faults)
    if faults:
        raise InputFaults(path, faults)
    return fields


def plain(value: Any) -> Any:
    """Returns a part of an arm's settings as plain values; fields with their default are left out."""
    if isinstance(value, Struct):
        config = value.__struct_config__
        tag = {config.tag_field: config.tag} if config.tag_field else {}
        given = [field for field in structs.fields(value) if getattr(value, field.name) != default_of(field)]
        return tag | {field.encode_name: plain(getattr(value, field.name)) for field in given}
    if isinstance(value, dict):
        return {name: plain(part) for name, part in value.items()}
    return [plain(part) for part in value] if isinstance(value, list | tuple) else value


def default_of(field: structs.FieldInfo) -> Any:
    return field.default if field.default_factory is NODEFAULT else field.default_factory()


def listed(modules: Sequence[Fields], folder: Path, faults: list[str], path: str = "") -> list[Fields]:
    """Returns entries of `modules` with the frames of their tables, which are CSV files in a folder.

    A sentence is appended to `faults` for each table that cannot be read; `path` is that of a group around.
    """
    found = list[Fields]()
    for g, entry in enumerate(modules):
        own, place = dict(entry), f"{path}modules[{g}]"
        if isinstance(own.get("modules"), list):
            own["modules"] = listed(own["modules"], folder, faults, f"{place}.")
        if isinstance(name := own.get("table"), str):
            del own["table"]
            table = read_table(folder, name, f"{place}.table", faults)
            own["states"] = [frame_fields(it, planar=table.planar) for it in table.frames] if table else []
        found.append(own)
    return found


def frame_fields(frame: frames.Frame, *, planar: bool) -> Fields:
    """Returns the fields of a file for a frame (4, 4)."""
    position = frame[: 2 if planar else 3, 3].tolist()
    return {"position": position, "orientation": frames.angle(frame) if planar else frames.quaternion(frame).tolist()}


def write_arm(path: Path, fields: Fields, comment: str) -> None:
    """Writes an arm's file after reading a draft of it back; `comment` is its first line.

    Raises:
        InputFaults: the fields describe no arm.
        OSError: the file cannot be written.
    """
    import yaml

    class Dumper(yaml.SafeDumper):
        """YAML without aliases, which an arm's file may not have."""

        def ignore_aliases(self, data: Any) -> bool:
            return True

    text = yaml.dump(fields, Dumper=Dumper, sort_keys=False, default_flow_style=None, width=120, allow_unicode=True)
    draft = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        draft.write_text(f"# {comment}\n{text}", encoding="utf-8")
        load(draft)
        draft.replace(path)
    finally:
        draft.unlink(missing_ok=True)
