"""Groups share their numbers, and a calibration fits the chosen parts only."""

from pathlib import Path

import numpy as np
import pytest

from hyperbit.controller.arm.arm import load
from hyperbit.controller.calibration.calibration import calibrated
from hyperbit.controller.calibration.fit import CannotFit
from hyperbit.controller.calibration.parameters import described, parameters
from hyperbit.controller.calibration.samples import Samples
from tests.calibration.making import arm_of, erring, measured

SLIDE = {"type": "prismatic", "axis": [0, 1], "cylinders": [[0, 0.025], [0, 0.05]], "link": {"position": [0, 0.06]}}
JOINT = {"type": "revolute", "angles": [-0.5236, 0.5236], "link": {"position": [0, 0.04]}}


def group(count: int = 10) -> list[dict]:
    return [{"type": "group", "count": count, "modules": [SLIDE, JOINT]}]


def paths(arm, *, each: bool) -> list[str]:
    return [
        it.path for it in parameters(described(arm, each=each), arm.manipulator.length, len(arm.manipulator.modules))
    ]


def test_a_group_has_the_numbers_of_one_repetition(tmp_path: Path) -> None:
    arm = arm_of(tmp_path, group())
    assert len(paths(arm, each=False)) == 15
    assert "modules[0].modules[1].link.position[1]" in paths(arm, each=False)
    assert len(paths(arm, each=True)) == 123
    assert "modules[19].angles[0]" in paths(arm, each=True)


def moved(arm, rng, count: int) -> Samples:
    """Tips of an arm whose base alone is elsewhere."""
    return measured(arm, erring(arm, rng, size=0.0, base=0.3), rng, count)


def test_the_base_alone_is_fitted_and_is_better_than_the_file(tmp_path: Path) -> None:
    arm = arm_of(tmp_path, group(3))
    found = calibrated(arm, moved(arm, np.random.default_rng(1), 20), each=False, parts=[])
    assert [change.parameter.where[0] for change in found.changes] == ["base"] * 3
    assert found.better
    assert found.description["modules"] == described(arm, each=False)["modules"]


def test_chosen_parts_are_fitted_and_no_others(tmp_path: Path) -> None:
    arm = arm_of(tmp_path, group(3))
    samples = moved(arm, np.random.default_rng(2), 20)
    found = calibrated(arm, samples, each=False, parts=["modules[1].modules[2].link"])
    fitted = {change.parameter.part for change in found.changes}
    assert fitted == {("base",), ("modules", 0, "modules", 1)}
    assert len(found.changes) == 6


def test_an_unknown_part_is_told_with_the_known_ones(tmp_path: Path) -> None:
    arm = arm_of(tmp_path, group(3))
    with pytest.raises(
        CannotFit, match=r"'modules\[2\]' has no numbers to fit; parts are base, modules\[1\]\.modules\[1\]"
    ):
        calibrated(arm, moved(arm, np.random.default_rng(3), 20), each=False, parts=["modules[2]"])


def test_a_file_with_a_group_keeps_it(tmp_path: Path) -> None:
    arm = load(arm_of(tmp_path, group(4)).path)
    (entry,) = described(arm, each=False)["modules"]
    assert (entry["type"], entry["count"], len(entry["modules"])) == ("group", 4, 2)
