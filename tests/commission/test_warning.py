"""An arm on real boards that was never commissioned has a warning, and works."""

from __future__ import annotations

import copy
import json
from pathlib import Path

from hyperbit.controller.armfile.actuators import read_wired
from hyperbit.controller.armfile.commissioned import record_path, warning_of
from tests.commission.rig import commissioned, entries, write_arm
from tests.executor.rig import ready


def warning(path: Path, interface: str = "socketcan") -> str | None:
    arm = json.loads(path.read_text())
    arm["buses"][0]["interface"] = interface
    path.write_text(json.dumps(arm))
    settings, labels, wired = read_wired(path)
    return warning_of(path, settings, labels, wired)


def test_the_record_says_who_was_commissioned_by_which_wiring(tmp_path: Path) -> None:
    file = entries("one output", "extended end")
    path = write_arm(tmp_path / "arm.yaml", file)
    assert str(warning(path)).startswith("4 of 4 actuators were never commissioned")
    assert warning(path, "virtual") is None
    commissioned(tmp_path, file, copy.deepcopy(file))
    assert warning(path) is None
    file["1.1"]["input"] = 7
    assert str(warning(write_arm(path, file))).startswith("actuator 1.1 was never commissioned")
    record_path(path).write_text("[")
    assert "arm.commission.json cannot be read" in str(warning(path))


def test_the_executor_tells_it_and_moves() -> None:
    rig = ready(uncommissioned="4 actuators were never commissioned")
    assert ("not-commissioned", "arm") in rig.faults
    rig.run(1)
    rig.go(0.5)
    assert rig.results == [(1, "done")]
