"""The command design, and its library call."""

from __future__ import annotations

import json

import numpy as np
import pytest
import yaml

import hyperbit as hb
from hyperbit.controller.commands.operate.run import load_wired
from tests.design.conftest import SMALL


@pytest.mark.usefixtures("own_folders")
def test_a_study_ends_with_a_table_a_picture_and_files_that_check_accepts(hyperbit, written, tmp_path):
    file, arms, picture = (
        written({"objectives": ["reached", "stuck", "actuators"]}),
        tmp_path / "arms",
        tmp_path / "p.png",
    )
    words = "design", str(file), "--evaluations", "12", "--output", str(tmp_path / "found.jsonl")
    code, out, err = hyperbit(*words, "--arms", str(arms), "--picture", str(picture))
    assert (code, err) == (0, "")
    assert "12 new targets in the same boxes" in out
    assert "other" in out
    assert picture.stat().st_size > 10_000
    files = sorted(arms.iterdir())
    assert files
    for path in files:
        assert hyperbit("check", str(path))[::2] == (0, "")
        assert load_wired(path).settings.name == path.stem
    code, out, _ = hyperbit(*words, "--json")
    found = json.loads(out)
    assert code == 0
    assert [row["arm"] for row in found["arms"]] == [*(path.stem for path in files), "other"]
    for row in found["arms"]:
        assert 0 <= row["final"]["stuck"] <= 1
        assert row["final"]["reached_error"] >= 0


@pytest.mark.usefixtures("own_folders")
def test_a_study_of_listed_targets_says_that_there_are_no_new_ones(hyperbit, written):
    file = written({"targets": [{"position": [0, 0.8]}, {"position": [0, 50]}]})
    code, out, err = hyperbit("design", str(file), "--evaluations", "8")
    assert code == 0
    assert "there are no new ones" in out
    assert "±" not in out
    assert "warning: target [0.0, 50.0] is more than the length of each of" in err


@pytest.mark.usefixtures("own_folders")
def test_a_requirement_that_no_design_meets_is_told(hyperbit, written):
    code, out, _ = hyperbit("design", str(written({"require": {"actuators": 1}, "arms": None})), "--evaluations", "8")
    assert code == 0
    assert "no design meets what the study requires: actuators 1" in out


def test_wrong_files_and_folders_are_refused(told, written, tmp_path):
    assert "no such file" in told("design", str(tmp_path / "none.yaml"), code=2)
    file = str(written({"parameters.width": {"between": [2, 1]}}))
    assert "line 1" in told("design", file, code=2)
    file = str(written())
    assert "cannot be written" in told("design", file, "--picture", str(tmp_path / "none" / "p.png"), code=2)
    (tmp_path / "text.jsonl").write_text("my own\n")
    assert "give the name of a new file" in told("design", file, "--output", str(tmp_path / "text.jsonl"), code=1)


def build(modules: int, width: float) -> hb.Arm:
    return hb.Arm([hb.vgt(width=width, lengths=(0.2, 0.25), count=modules)], tolerance=0.05)


def test_the_library_designs_saves_and_plots(tmp_path, written):
    parameters = {"modules": {"between": [2, 4]}, "width": {"between": [0.15, 0.7]}}
    targets = [(0.0, 0.8), {"box": {"centre": [0, 0.8], "size": [0.2, 0.2]}, "count": 4}]
    study = hb.Study(build, parameters, targets, require={"reached": 0.2}, finalists={"targets": 10})
    found = hb.design(study, 24, 1)
    assert repr(study) == "Study('study': modules, width; 5 targets)"
    (*paths,) = found.save(tmp_path / "arms")
    assert [hb.load(path).name for path in paths] == [one.name for one in found.front]
    for one in found.front:
        assert one.first["reached"] >= 0.2
        assert one.arm.actuators == build(**one.values).actuators
        assert hb.merit(one.arm, [(0.0, 0.8)], stuck=False).actuators == one.final["actuators"]
    assert "10 new targets" in found.table()
    found.plot().savefig(tmp_path / "p.png")
    again = hb.design(written(), 8)
    assert again.front[-1].values is None
    assert (len(again.evaluations), again.warnings) == (8, ())


@pytest.mark.parametrize(
    ("parameters", "targets", "fields", "fault"),
    [
        ({}, [(0, 1)], {}, "parameters: 1 to 20 are needed"),
        ({"width": {"between": [3, 2]}}, [(0, 1)], {}, "3 must be less than 2"),
        ({"width": {"between": [0.1, 0.2]}}, [(0, 1, 2)], {}, "a planar arm has 2 coordinates"),
        ({"width": {"between": [0.1, 0.2]}}, [(0, 1)], {"objective": ["reached"]}, "did you mean 'objectives'"),
        ({"width": {"between": [0.7, 0.9]}}, [(0, 1)], {}, "200 random designs in a row were impossible"),
    ],
)
def test_a_wrong_study_is_refused(parameters, targets, fields, fault):
    with pytest.raises(hb.StudyError, match=fault):
        hb.Study(lambda width: build(2, width), parameters, targets, **fields)


def test_wrong_calls_are_refused(written, tmp_path):
    with pytest.raises(hb.StudyError, match="build: an Arm is needed, got 3"):
        hb.Study(lambda width: 3, {"width": {"between": [1, 2]}}, [(0, 1)])  # type: ignore[arg-type, return-value]
    with pytest.raises(hb.StudyError, match="build: a function of width is needed"):
        hb.Study(lambda height: 3, {"width": {"between": [1, 2]}}, [(0, 1)], seed=np.int64(1))  # type: ignore[arg-type]
    with pytest.raises(hb.StudyError, match="evaluations: a whole number from 1"):
        hb.design(written(), 0)
    with pytest.raises(hb.StudyError, match="no such file"):
        hb.design(tmp_path / "none.yaml")
    assert yaml.safe_load(written().read_text())["name"] == SMALL["name"]
