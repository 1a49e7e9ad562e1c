"""Exceptions of the library: one hierarchy, with messages that name the argument."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import hyperbit as hb

VGT = {"width": 0.2, "lengths": (0.2, 0.25)}
MIRROR = np.diag([1.0, 1.0, -1.0, 1.0])

WRONG: dict[str, tuple[type[hb.Error], str, Callable[[hb.Arm], object]]] = {
    "no file": (hb.ArmError, "no such file", lambda arm: hb.load("/nowhere.yaml")),
    "no modules": (hb.ArmError, "modules", lambda arm: hb.Arm([])),
    "width": (hb.ArmError, "vgt: width: .*> 0", lambda arm: hb.vgt("BC", width=-1, lengths=(0.2, 0.25))),
    "diagonal": (hb.ArmError, "first_diagonal", lambda arm: hb.vgt("XY", **VGT)),  # type: ignore[arg-type]
    "lengths": (hb.ArmError, "left is 0.3", lambda arm: hb.Arm([hb.vgt("BC", width=0.2, lengths=(0.3, 0.2))])),
    "name": (hb.ArmError, "name", lambda arm: hb.Arm([hb.vgt("BC", **VGT)], name="a b")),
    "mirror": (hb.ArmError, "rotation and a translation", lambda arm: hb.transforms([np.eye(4), MIRROR])),
    "frames": (hb.ArmError, r"\(K, 4, 4\)", lambda arm: hb.transforms(np.eye(3))),
    "own obstacle": (hb.ArmError, "radius", lambda arm: hb.Arm([hb.vgt("BC", **VGT)], obstacles=[hb.Disc((0, 9), -1)])),
    "short configuration": (hb.ConfigurationError, r"shape \(4,\)", lambda arm: arm.frame([0, 0])),
    "state": (hb.ConfigurationError, "states 0 to 7", lambda arm: arm.frame([0, 0, 0, 8])),
    "fractions": (hb.ConfigurationError, "integers", lambda arm: arm.frame([0.5, 0, 0, 0])),
    "text": (hb.ConfigurationError, "3 modules", lambda arm: arm.frame("012")),
    "actuators": (hb.ConfigurationError, "12 actuator states", lambda arm: arm.configuration([0, 1])),
    "label": (hb.LockError, "9.left", lambda arm: arm.lock({"9.left": "extended"})),
    "lock": (hb.LockError, "'up'", lambda arm: arm.lock({"1.left": "up"})),  # type: ignore[dict-item]
    "start": (
        hb.ConfigurationError,
        "as actuators are locked",
        lambda arm: hb.Solver(arm.lock({"1.left": "extended"})).solve((0.1, 0.9), start=[0] * 4),
    ),
    "dimension": (hb.GoalError, "2 coordinates, got 3", lambda arm: hb.Solver(arm).solve((1, 2, 3))),
    "goal": (hb.GoalError, "finite", lambda arm: hb.Goal((np.nan, 0))),
    "goal's text": (hb.GoalError, "position: finite numbers", lambda arm: hb.Goal("a")),
    "tolerance": (hb.GoalError, "tolerance", lambda arm: hb.Goal((0, 0), tolerance=-1)),
    "angle": (hb.GoalError, "quaternion", lambda arm: hb.Goal((0, 0, 0), 0.5)),
    "quaternion": (hb.GoalError, "length 1", lambda arm: hb.Goal((0, 0, 0), (0, 0, 0, 2))),
    "method": (hb.GoalError, "minimum-switch", lambda arm: hb.Solver(arm).solve((0, 0), method="best")),  # type: ignore[arg-type]
    "weights": (hb.GoalError, "12 positive", lambda arm: hb.Solver(arm, weights=[1, 2])),
    "deadline": (
        hb.GoalError,
        "deadline: a finite number is needed, got nan",
        lambda arm: hb.Solver(arm).solve((0, 0), deadline=np.nan),
    ),
    "endless weight": (hb.GoalError, "weights: finite", lambda arm: hb.Solver(arm, weights=[np.inf] * 12)),
    "no goals": (hb.GoalError, "1 to", lambda arm: hb.Solver(arm).follow([])),
    "sphere": (hb.ObstacleError, "planar arm", lambda arm: hb.Solver(arm, obstacles=[hb.Sphere((0, 0, 0), 1)])),
    "words": (hb.ArmError, "numbers", lambda arm: hb.revolute(["left", "right"])),
    "no width": (hb.ArmError, "width", lambda arm: hb.vgt("BC", width=None, lengths=(0.2, 0.25))),  # type: ignore[arg-type]
    "no module": (hb.ArmError, "modules: a list of modules", lambda arm: hb.Arm([7])),  # type: ignore[list-item]
    "a file": (hb.ArmError, "hb.load reads an arm's file", lambda arm: hb.Arm("arm.yaml")),
    "base": (hb.ArmError, "base: finite numbers", lambda arm: hb.Arm([hb.vgt("BC", **VGT)], base=(np.nan, 0))),
    "centre": (hb.ObstacleError, "numbers", lambda arm: hb.Solver(arm, obstacles=[hb.Disc("here", 1)])),
    "no obstacle": (hb.ObstacleError, "one of Disc", lambda arm: hb.Solver(arm, obstacles=[(0, 0)])),  # type: ignore[list-item]
    "far": (hb.PathError, "out of reach", lambda arm: hb.Solver(arm).follow([(100, 100)])),
    "points": (hb.GoalError, "points", lambda arm: arm.density().at([1, 2, 3])),
    "tips": (hb.CalibrationError, "shape", lambda arm: hb.calibrate(arm, arm.sample(20), np.zeros((19, 2)))),
    "few": (hb.CalibrationError, "at least 10", lambda arm: hb.calibrate(arm, arm.sample(3), np.zeros((3, 2)))),
}


@pytest.mark.parametrize("what", WRONG)
def test_errors_name_the_wrong_argument(what: str, arm: hb.Arm) -> None:
    kind, words, act = WRONG[what]
    with pytest.raises(hb.Error, match=words) as caught:
        act(arm)
    assert type(caught.value) is kind


def test_a_wrong_file_names_each_fault(tmp_path: Path) -> None:
    file = tmp_path / "arm.yaml"
    file.write_text("name: a b\nmodules: [{type: vgt, width: -1, lengths: [0.2, 0.25]}]\ntolerance: {position: 0.01}\n")
    with pytest.raises(hb.ArmError) as caught:
        hb.load(file)
    assert len(caught.value.faults) == 2
    assert len(caught.value.lines) == 2
