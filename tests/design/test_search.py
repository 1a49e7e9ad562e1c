"""The search is the same with known figures, after kills, and with more designs; its file is kept or set aside."""

from __future__ import annotations

import json
from dataclasses import replace

import pytest

from hyperbit.controller.design.kept import kept
from hyperbit.controller.design.search import MOST_IMPOSSIBLE, evaluations
from hyperbit.controller.design.study import Impossible, read_study
from hyperbit.controller.studies.shares import StudyFailed
from tests.design.conftest import run


def worth(batch):
    return [{"reached": 0.5, "switches": values["width"], "actuators": values["modules"]} for values in batch]


def test_known_figures_lead_to_the_same_designs(study):
    whole = list(evaluations(study, 30, 3, [], worth))
    for known in (0, 7, 8, 21, 30):
        judged = []

        def counted(batch, judged=judged):
            judged.extend(batch)
            return worth(batch)

        assert list(evaluations(study, 30, 3, whole[:known], counted)) == whole
        assert len(judged) == 30 - known
    assert any(one.values != two.values for one, two in zip(whole, evaluations(study, 30, 4, [], worth), strict=True))
    assert all(isinstance(one.values["modules"], int) for one in whole)
    steps = [(one.values["stroke"] - 0.02) / 0.005 for one in whole]
    assert max(abs(step - round(step)) for step in steps) < 1e-6


def test_a_study_killed_at_ten_places_and_resumed_gives_the_same_bytes(study, tmp_path):
    run(study, tmp_path / "whole.jsonl")
    whole = (tmp_path / "whole.jsonl").read_bytes()
    path = tmp_path / "killed.jsonl"
    for steps in (1, 2, 3, 5, 3, 8, 4, 7, 2, 1):
        run(study, path, steps=steps + len(path.read_bytes().splitlines()) - 1 if path.exists() else steps)
        with path.open("ab") as file:
            file.write(b'{"design": 3')  # half a line
    run(study, path)
    assert path.read_bytes() == whole
    run(study, path)
    assert path.read_bytes() == whole
    assert not path.with_name(".killed.jsonl.lock").exists()


def test_more_designs_go_on_and_fewer_are_refused(study, tmp_path):
    run(study, tmp_path / "30.jsonl", 30)
    path = tmp_path / "12.jsonl"
    run(study, path, 12)
    run(study, path, 30)
    assert path.read_bytes() == (tmp_path / "30.jsonl").read_bytes()
    with pytest.raises(StudyFailed, match="it has 30 designs: ask for as many evaluations"):
        run(study, path, 12)


@pytest.mark.parametrize("damage", [b"\0" * 40, b'{"design": 9}', b'{"final": 3, "figures": {"reached": "x"}}', b"[1]"])
def test_a_damaged_file_is_set_aside_and_told(study, tmp_path, damage, caplog):
    path = tmp_path / "found.jsonl"
    run(study, path, 12)
    whole = path.read_bytes()
    lines = whole.split(b"\n")
    path.write_bytes(b"\n".join([*lines[:4], damage, *lines[5:]]))
    with kept(path, study, 5, 12) as found:
        assert found.designs == []
    assert "was damaged (line 5" in caplog.text
    (aside,) = tmp_path.glob("found.jsonl.damaged-*")
    assert damage in aside.read_bytes()
    run(study, path, 12)
    assert path.read_bytes() == whole


def test_a_file_of_something_else_is_refused(written, tmp_path):
    path, study = tmp_path / "found.jsonl", read_study(written())
    run(study, path, 8)
    whole = path.read_bytes()
    with pytest.raises(StudyFailed, match="belong to another seed"), kept(path, study, 6, 8):
        pass
    other = read_study(written({"parameters.width.between": [0.1, 0.35]}))
    with pytest.raises(StudyFailed, match="belong to another study"), kept(path, other, 5, 8):
        pass
    more = read_study(written({"evaluations": 99}))
    with kept(path, more, 5, 8) as found:
        assert len(found.designs) == 8
        with pytest.raises(StudyFailed, match=r"end the other study, .*: process"):
            kept(path, more, 5, 8).__enter__()
    assert path.read_bytes() == whole
    header = json.loads(whole.splitlines()[0]) | {"hyperbit": "0.0.1", "optuna": "1.0"}
    path.write_bytes(b"\n".join([json.dumps(header).encode(), *whole.split(b"\n")[1:]]))
    with pytest.raises(StudyFailed, match="another version of hyperbit and another version of optuna"):
        run(study, path, 8)
    path.write_text("x,y\n1,2\n")
    with pytest.raises(StudyFailed, match="no results of a study of designs"):
        run(study, path, 8)
    assert path.read_text() == "x,y\n1,2\n"


def test_impossible_arms_are_drawn_again_and_counted(written):
    study = read_study(written({"parameters.width.between": [0.1, 1.0]}))
    found = list(evaluations(study, 16, 0, [], worth))
    assert sum(one.impossible for one in found) > 0
    for one in found:
        study.build(one.values)
    again = list(evaluations(study, 16, 0, found, lambda batch: pytest.fail("known")))
    assert again == found


def test_impossible_arms_only_end_the_search(study):
    class Never:
        def __call__(self, values):
            raise Impossible(f"modules[0].width: {values['width']} does not fit")

    study = replace(study, build=Never())
    with pytest.raises(StudyFailed, match=rf"arm.modules\[0\].width: {MOST_IMPOSSIBLE} random designs in a row"):
        list(evaluations(study, 8, 0, [], worth))
