"""The command calibrate: written files and refused input."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import yaml

from hyperbit.controller.arm.arm import load
from hyperbit.controller.manipulator import frames
from hyperbit.controller.manipulator.notation import format_configuration
from tests.calibration.making import ARMS, arm_of, erring, measured


@pytest.fixture
def files(request, tmp_path):
    """An arm's file, and one of what was measured of the real arm: of mixed modules, unless a test says which."""
    modules = getattr(request, "param", "mixed")
    arm, rng = arm_of(tmp_path, ARMS[modules], travel_time=0.2), np.random.default_rng(1)
    return str(tmp_path / "arm.yaml"), str(written(tmp_path, arm, measured(arm, erring(arm, rng), rng, 80)))


def written(folder, arm, samples):
    planar, lines = arm.manipulator.planar, ["configuration,x,y,th" if arm.manipulator.planar else SPATIAL]
    for configuration, tip in zip(samples.configurations, samples.tips, strict=True):
        turn = [frames.angle(tip)] if planar else frames.quaternion(tip).tolist()
        numbers = [*tip[: arm.manipulator.dimension, 3].tolist(), *turn]
        lines.append(f'"{format_configuration(arm.manipulator, configuration)}",{",".join(map(repr, numbers))}')
    file = folder / "samples.csv"
    file.write_text("\n".join(lines) + "\n")
    return file


pytestmark = pytest.mark.timeout(900)  # a calibration is twelve fits: seconds alone, minutes beside other programs
SPATIAL = "configuration,x,y,z,qx,qy,qz,qw"


@pytest.mark.parametrize("files", ["mixed", "platforms"], indirect=True)
def test_the_new_file_is_an_arm_that_meets_the_samples(hyperbit, files, tmp_path):
    arm, samples = files
    new = tmp_path / "new.yaml"
    code, out, _ = hyperbit("calibrate", arm, samples, "--out", str(new), "--json")
    told = json.loads(out)
    assert code == 0
    assert told["out"] == str(new)
    assert told["held_out"]["position"]["rms"] < 0.1 * told["before"]["position"]["rms"]
    assert hyperbit("check", str(new))[0] == 0
    before, after = (yaml.safe_load(Path(name).read_text()) for name in (arm, new))
    assert {key: before[key] for key in ("name", "tolerance", "travel_time")}.items() <= after.items()
    manipulator, off = load(new).manipulator, []
    for row in Path(samples).read_text().splitlines()[1:]:
        text, *numbers = row.rpartition('"')[0].strip('"'), *row.rpartition('"')[2].split(",")[1:]
        configuration = [int(state) for state in (text.split(",") if "," in text else text)]
        d = manipulator.dimension
        off.append(np.linalg.norm(manipulator.tip(configuration)[:d, 3] - np.array(numbers[:d], dtype=float)))
    assert np.sqrt(np.mean(np.square(off))) == pytest.approx(told["after"]["position"]["rms"], rel=1e-4)


def test_the_table_names_fields_and_residuals(hyperbit, files):
    arm, samples = files
    code, out, _ = hyperbit("calibrate", arm, samples)
    assert code == 0
    for words in ("80 samples", "held out", "modules[1].lengths[2]", "base.position[1]"):
        assert words in out


def test_existing_files_are_not_overwritten(hyperbit, files, tmp_path):
    arm, samples = files
    before = Path(arm).read_text()
    code, out, err = hyperbit("calibrate", arm, samples, "--out", arm)
    assert (code, out, Path(arm).read_text()) == (2, "", before)
    assert "the file exists" in err
    assert hyperbit("calibrate", arm, samples, "--out", arm, "--force", "--json")[0] == 0
    assert Path(arm).read_text() != before
    assert sorted(p.name for p in tmp_path.iterdir()) == ["arm.yaml", "samples.csv"]


def test_no_better_is_said_and_not_written(hyperbit, files, tmp_path):
    arm, samples = files
    new, newer = tmp_path / "new.yaml", tmp_path / "newer.yaml"
    hyperbit("calibrate", arm, samples, "--out", str(new), "--json")
    code, out, err = hyperbit("calibrate", str(new), samples, "--out", str(newer), "--json")
    assert (code, json.loads(out)["better"], json.loads(out)["out"]) == (1, False, None)
    assert "no better" in err
    assert not newer.exists()


def test_faults_of_samples_are_unusable_input(hyperbit, files, tmp_path):
    arm, samples = files
    few = tmp_path / "few.csv"
    few.write_text("".join(Path(samples).read_text().splitlines(True)[:8]))
    code, out, err = hyperbit("calibrate", arm, str(few), "--json")
    assert (code, out) == (2, "")
    assert "few.csv: 7 samples, at least 10 are needed" in err
    few.write_text("x\n")
    code, out, err = hyperbit("calibrate", arm, str(few))
    assert (code, out) == (2, "")
    assert "columns configuration or actuators" in err
