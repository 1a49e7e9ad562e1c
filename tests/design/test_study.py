"""Files of studies: what is wrong is named with its line."""

from __future__ import annotations

import math

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from hyperbit.controller.armfile.strict import InputFaults
from hyperbit.controller.design.study import read_study
from hyperbit.controller.design.template import filled, names_in

MANY = {f"p{k}": {"between": [0, 1]} for k in range(21)}
VGT = {"type": "vgt", "count": "$modules", "width": "$width", "lengths": ["$short", {"sum": ["$short", "$stroke"]}]}
WIDE = [{"box": {"centre": [0, 1], "size": [1, width]}, "count": 1000} for width in (1, 2)]
FIRST = {**VGT, "first_diagonal": "$first"}
BOX = {"centre": [0, 0.8], "size": [0.8, 0.4]}


@pytest.mark.parametrize(
    ("changes", "place", "fault"),
    [
        ({"arm.body_radius": "$thick"}, "body_radius", "arm.body_radius: $thick is no parameter; there are modules"),
        ({"parameters.spare": {"between": [0, 1]}}, "spare", "parameters.spare: the arm does not use $spare"),
        ({"parameters.width.between": [0.4, 0.1]}, "between", "0.4 must be less than 0.1"),
        ({"parameters.width": {}}, "width", "either between or among is needed"),
        ({"parameters.width.step": 2.0}, "step", "2 is more than from 0.1 to 0.4"),
        ({"parameters.first.among": ["BC", "BC"]}, "among", "a value occurs twice"),
        ({"parameters": {}}, "parameters", "parameters: 1 to 20 are needed, got 0"),
        ({"parameters": MANY}, "parameters", "parameters: 1 to 20 are needed, got 21"),
        ({"targets": []}, "targets", "targets: 1 to 1000 are needed, got 0"),
        ({"targets": WIDE}, "targets", "targets: 1 to 1000 are needed, got 2000"),
        ({"targets": [{"position": [0, 1, 2]}]}, "position", "targets[1].position: a planar arm has 2 coordinates"),
        ({"targets": [{"box": {**BOX, "size": [1, 1, 1]}, "count": 2}]}, "size", "a planar arm has 2 coordinates"),
        ({"targets": [{"position": [0, 1], "orientation": [0, 0, 0, 1]}]}, "orientation", "an angle [rad] is needed"),
        ({"targets": [{"position": [0, 1], "count": 3}]}, "count", "a position has none"),
        ({"targets": [{"box": BOX}]}, "box", "a box needs the number of its targets"),
        ({"targets": [{"position": [0, 1], "angle_tolerance": 0.1}]}, "angle_tolerance", "has no orientation"),
        ({"objectives": ["reached", "switchs"]}, "objectives", "did you mean 'switches'?"),
        ({"objectives": ["reached", "reached"]}, "objectives", "reached occurs twice"),
        ({"objectives": ["reached"]}, "objectives", "length >= 2"),
        ({"require": {"mass": 3}}, "require", "'mass' is unknown"),
        ({"evaluations": 0}, "evaluations", ">= 1"),
        ({"arm.modules": [{**FIRST, "widht": 1}]}, "widht", "unknown field"),
        ({"arm.modules": [{"type": "transforms", "table": "gone.csv"}, FIRST]}, "table", "gone.csv"),
        ({"arms": ["missing.yaml"]}, None, "missing.yaml: no such file"),
    ],
)  # fmt: skip
def test_what_is_wrong_is_named_with_its_line(written, changes, place, fault):
    path = written(changes)
    with pytest.raises(InputFaults) as wrong:
        read_study(path)
    text = str(wrong.value)
    assert fault in text, text
    if place is not None:
        line = next(int(one.split("line ")[1].split(":")[0]) for one in text.splitlines() if fault in one)
        around = path.read_text().splitlines()[max(0, line - 2) : line + 1]
        assert any(place in one or "- " in one for one in around), text


def test_impossible_arms_only_are_told_with_the_commonest_fault(written):
    path = written({"parameters.width.between": [0.9, 1.0]})
    with pytest.raises(InputFaults) as wrong:
        read_study(path)
    assert "200 random designs in a row were impossible, 200 of them here" in str(wrong.value)
    assert "arm.modules[1].lengths" in str(wrong.value)


def test_a_target_out_of_reach_of_all_arms_is_warned_of(written):
    study = read_study(written({"targets": [{"position": [0, 30]}, {"position": [0, 0.8]}]}))
    assert [warning.partition(" is ")[0] for warning in study.warnings()] == ["target [0.0, 30.0]"]


def test_targets_are_drawn_by_the_seed_and_fresh_ones_differ(written):
    one, other = read_study(written()), read_study(written({"seed": 2}))
    again = read_study(written())
    drawn = [[target.position.tolist() for target in study.targets] for study in (one, again, other)]
    assert drawn[0] == drawn[1] != drawn[2]
    assert (len(one.targets), len(one.fresh)) == (9, 12)
    assert not {tuple(p) for p in drawn[0]} & {tuple(target.position) for target in one.fresh}
    assert read_study(written({"targets": [{"position": [0, 1]}]})).fresh == ()
    assert (one.digest, one.digest == again.digest, one.digest == other.digest) == (one.digest, True, False)


def test_the_shared_study_is_read(tmp_path):
    fields = """
name: shelf
parameters:
  lower: {between: [4, 8]}
  upper: {between: [4, 8]}
  first: {among: [BC, AD]}
  width: {between: [0.1, 0.3]}
  short: {between: [0.1, 0.3], step: 0.005}
  stroke: {between: [0.02, 0.1]}
  turn: {between: [-0.4, 0.4]}
arm:
  base: {position: [0, 0], orientation: $turn}
  tolerance: {position: 0.0005}
  modules:
    - {type: vgt, count: $lower, first_diagonal: $first, width: $width, lengths: [$short, {sum: [$short, $stroke]}]}
    - {type: vgt, count: $upper, width: $width, lengths: [0.2, 0.25]}
  obstacles: [{name: pillar, disc: {centre: [0.5, 1.5], radius: 0.2}}]
targets:
  - {box: {centre: [0, 1.25], size: [2.4, 1.3]}, count: 40}
  - {position: [0.3, 1.9], weight: 5, tolerance: 0.002}
  - {position: [0.4, 1.7], orientation: 0.3}
require: {reached: 0.5}
"""
    (tmp_path / "shelf.yaml").write_text(fields)
    study = read_study(tmp_path / "shelf.yaml")
    assert len(study.targets) == 42
    assert study.targets[40].weight == 5
    assert study.targets[41].goal.shape == (4, 4)


def test_units_groups_and_tables_of_an_arm_are_those_of_its_file(tmp_path):
    (tmp_path / "states.csv").write_text("x,y,th\n0,200,0.1\n0,250,-0.1\n")
    (tmp_path / "study.yaml").write_text("""
name: mine
parameters: {count: {between: [1, 3]}, link: {between: [50, 150]}}
arm:
  unit: mm
  tolerance: {position: 2 mm}
  modules:
    - count: $count
      modules:
        - {type: transforms, table: states.csv}
        - {type: revolute, angles: [-30 deg, 30 deg], link: {position: [0, $link]}}
targets: [{position: [10 cm, 300], tolerance: 1 cm}]
""")
    study = read_study(tmp_path / "study.yaml")
    (tmp_path / "states.csv").unlink()  # workers elsewhere have none
    arm = study.build({"count": 2, "link": 100})
    assert (arm.arm.settings.unit, len(arm.manipulator.modules)) == ("mm", 4)
    assert (study.targets[0].position.tolist(), study.targets[0].tolerance) == ([100.0, 300.0], 10.0)


numbers = st.integers(-5, 5) | st.floats(-5, 5)
trees = st.recursive(
    numbers | st.sampled_from(["$a", "$b", "text"]),
    lambda part: st.lists(part, max_size=3) | st.dictionaries(st.sampled_from(["x", "y"]), part, max_size=2),
    max_leaves=8,
)


@given(trees)
def test_a_filled_template_names_no_parameter(tree):
    done = filled(tree, {"a": 1, "b": 2.5})
    assert not list(names_in(done))
    assert {name for name, _ in names_in(tree)} <= {"a", "b"}


@given(st.lists(numbers, min_size=1, max_size=4))
def test_sums_and_products_are_those_of_numbers(parts):
    assert filled({"sum": [*parts, "$a"]}, {"a": 2}) == pytest.approx(sum(parts) + 2)
    assert filled({"product": parts}, {}) == pytest.approx(math.prod(parts))
    assert filled({"sum": [*parts, "text"]}, {}) == {"sum": [*parts, "text"]}
    assert yaml.safe_load("{sum: [$a, 1]}") == {"sum": ["$a", 1]}
