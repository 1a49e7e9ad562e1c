"""Saved arms are the same arms, and `hyperbit check` accepts their files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import hyperbit as hb
from tests.commands.conftest import hyperbit  # noqa: F401

DEPLOY = Path(__file__).parents[2] / "deploy"
JOINTS = [(0.15, 0, 0), (-0.075, 0.13, 0), (-0.075, -0.13, 0)]
trusses = st.builds(
    lambda diagonal, width, short, stroke, count: hb.vgt(
        diagonal, width=width, lengths=(short, short + stroke), count=count
    ),
    st.sampled_from(["BC", "AD"]),
    st.floats(0.18, 0.22),
    st.floats(0.18, 0.2),
    st.floats(1e-6, 0.05),
    st.integers(1, 3),
)
joints = st.builds(
    lambda angles, axis: hb.revolute(angles, axis=axis, link=(0.0, 0.2, 0.1)),
    st.lists(st.floats(-1.5, 1.5), min_size=2, max_size=5, unique=True),
    st.sampled_from([(0, 0, 1), (1, 0, 0)]),
)
slides = st.builds(lambda pair: hb.prismatic((0, 1), cylinders=[pair], count=2), st.just((0.0, 1e-5)))
platforms = st.builds(lambda most: hb.platform(JOINTS, JOINTS, (0.18, most)), st.floats(0.19, 0.22))
single = trusses | joints | slides | platforms
groups = st.builds(
    lambda own, count: hb.group(own, count=count), st.lists(single, min_size=1, max_size=2), st.integers(1, 3)
)
modules = st.lists(single | groups, min_size=1, max_size=4)


def same(one: hb.Arm, other: hb.Arm) -> None:
    rows = one.sample(5)
    np.testing.assert_allclose(other.frames(rows), one.frames(rows), atol=1e-12)
    assert (other.actuators, other.locked, other.tolerance) == (one.actuators, one.locked, one.tolerance)
    np.testing.assert_array_equal(other.weights, one.weights)


@settings(deadline=None, max_examples=40)
@given(modules, st.floats(1e-4, 0.1), st.none() | st.just((0.1, 0.0)), st.sampled_from([None, "mm", "m"]))
def test_an_arm_in_code_is_read_back(tmp_path_factory, chain, tolerance, tip, unit):
    path = tmp_path_factory.getbasetemp() / "round.yaml"
    arm = hb.Arm(chain, name="round", tolerance=tolerance, tip=tip, base=(1.0, 2.0), unit=unit)
    arm.save(path)
    again = hb.load(path)
    assert again.unit == unit
    same(arm, again)
    text = path.read_text()
    again.save(path)
    assert path.read_text() == text


@pytest.mark.parametrize("file", sorted(DEPLOY.glob("*.yaml")), ids=lambda path: path.stem)
def test_check_accepts_a_saved_arm(hyperbit, tmp_path, file):  # noqa: F811
    path = tmp_path / "saved.yaml"
    hb.load(file).save(path)
    same(hb.load(file), hb.load(path))
    code, _, err = hyperbit("check", str(path))
    assert (code, err) == (0, "")


def test_a_table_is_written_out(tmp_path):
    (tmp_path / "states.csv").write_text("x,y,th\n0,0.2,0.1\n0,0.25,-0.1\n")
    fields = "name: measured\ntolerance: {position: 0.01}\n"
    fields += "modules: [{modules: [{type: transforms, table: states.csv}], count: 3}]\n"
    fields += "wiring: wired.csv\nbuses: [{name: can0, channel: can0}]\n"
    rows = [f"{module},1,can0,1,{module}" for module in (1, 2, 3)]
    (tmp_path / "wired.csv").write_text("\n".join(["module,actuator,bus,node,output", *rows, ""]))
    (tmp_path / "arm.yaml").write_text(fields)
    arm = hb.load(tmp_path / "arm.yaml")
    (elsewhere := tmp_path / "elsewhere").mkdir()
    arm.save(elsewhere / "arm.yaml")
    same(arm, hb.load(elsewhere / "arm.yaml"))


def test_a_calibrated_arm_is_written(tmp_path, arm):
    rows = arm.sample(40, seed=1)
    longer = hb.Arm([hb.vgt("BC", width=0.201, lengths=(0.2, 0.252), count=4)], tolerance=0.01)
    fitted = hb.calibrate(arm, rows, longer.frames(rows)).arm
    fitted.save(tmp_path / "fitted.yaml")
    same(fitted, hb.load(tmp_path / "fitted.yaml"))


def test_locked_actuators_are_stuck_in_the_file_if_the_arm_is_wired(tmp_path, arm):
    wired = hb.load(DEPLOY / "planar16.yaml").lock({"5.left": "extended"})
    wired.save(tmp_path / "locked.yaml")
    assert hb.load(tmp_path / "locked.yaml").locked == {"5.left": "extended"}
    with pytest.raises(hb.LockError, match="by their wiring"):
        arm.lock({"1.left": "extended"}).save(tmp_path / "arm.yaml")


def test_a_file_that_cannot_be_written_is_told(tmp_path, arm):
    with pytest.raises(hb.ArmError, match="cannot be written: No such file"):
        arm.save(tmp_path / "missing" / "arm.yaml")
