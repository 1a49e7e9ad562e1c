"""A copy of an arm's file with long time-outs, for simulated arms on a computer that stands still at times."""

import contextlib
import shutil
from pathlib import Path, PurePath

import yaml

from hyperbit.controller.armfile.documents import read_yaml
from hyperbit.controller.armfile.places import placed_faults
from hyperbit.controller.armfile.settings import files_beside, read_settings
from hyperbit.controller.armfile.strict import InputFaults

SILENCE_TIMEOUT = 10.0  # [s] of silence until boards, executor or planner count as lost


def patient_copy(file: Path, folder: Path) -> Path:
    """Writes a copy of an arm's file with long time-outs between boards, executor and planner; returns its path.

    Longer time-outs of the file remain. A demo and a replay ask for this copy: they shall end on a busy computer, too.

    Args:
        file: the arm's file.
        folder: of the copy; not the folder of the file.

    Raises:
        InputFaults: the file is wrong.
    """
    with placed_faults(file):
        settings, faults = read_settings(file)
        if faults:
            raise InputFaults(file, faults)
    document = read_yaml(file)
    silence = max(settings.boards.heartbeat_timeout, SILENCE_TIMEOUT)
    document["boards"] = {**(document.get("boards") or {}), "heartbeat_timeout": silence}
    document["planner_timeout"] = max(settings.planner_timeout, SILENCE_TIMEOUT)
    for name in files_beside(settings):
        if not PurePath(name).is_absolute():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            with contextlib.suppress(OSError):  # the reader of the copy tells
                shutil.copyfile(file.parent / name, folder / name)
    copy = folder / file.name
    copy.write_text(yaml.safe_dump(document, allow_unicode=True), encoding="utf-8")
    return copy
