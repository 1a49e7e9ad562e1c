"""The module types of an arm's file: what they give, and every fault by the path of its field."""

import math
from pathlib import Path

import numpy as np
import pytest
import yaml
from numpy.testing import assert_allclose

from hyperbit.controller.arm.arm import load
from hyperbit.controller.armfile.strict import InputFaults
from hyperbit.controller.manipulator import frames
from hyperbit.controller.manipulator.joints import prismatic, revolute
from hyperbit.controller.manipulator.platform import platform

BASE, TOP = (
    [[round(0.15 * math.cos(math.radians(d)), 4), round(0.15 * math.sin(math.radians(d)), 4), 0.0] for d in degrees]
    for degrees in ([350, 10, 110, 130, 230, 250], [310, 50, 70, 170, 190, 290])
)
REVOLUTE = {"type": "revolute", "angles": [-0.2, 0.3], "link": {"position": [0, 0.1]}}
PRISMATIC = {"type": "prismatic", "axis": [0, 1], "lengths": [0.1, 0.15, 0.2]}
PLATFORM = {"type": "platform", "base": BASE, "top": TOP, "lengths": [0.18, 0.22]}
LISTED = {"type": "transforms", "states": [{"position": [0, 1]}, {"position": [0, 2]}]}


def described(*modules: dict) -> dict:
    return {"name": "a", "modules": list(modules), "tolerance": {"position": 0.01}}


def test_joints_are_what_the_file_says(read):
    turned = {"position": [0, 0, 0.1], "orientation": [0, 0, 0.6, 0.8]}
    arm = read(
        described(
            {**REVOLUTE, "count": 2},
            {**REVOLUTE, "axis": [1, 0, 0], "link": turned},
            PRISMATIC,
            {**PRISMATIC, "axis": [0, 0, 2], "link": turned},
        )
    )
    link, spatial = frames.planar(0, 0.1), frames.spatial((0, 0, 0.1), (0, 0, 0.6, 0.8))
    angles, lengths = [-0.2, 0.3], [0.1, 0.15, 0.2]
    expected = [
        *[revolute((0, 0, 1), angles, link)] * 2,
        revolute((1, 0, 0), angles, spatial),
        prismatic((0, 1, 0), lengths, np.eye(4)),
        prismatic((0, 0, 1), lengths, spatial),
    ]
    for module, wanted in zip(arm.manipulator.modules, expected, strict=True):
        assert_allclose(module.frames, wanted.frames, atol=0)
        assert module.planar == wanted.planar
    assert arm.manipulator.actuators == ("1.1", "2.1", "3.1", "4.1", "4.2", "5.1", "5.2")
    assert read(described(REVOLUTE, PRISMATIC)).manipulator.planar


def test_a_chain_of_all_types(read):
    truss = {"type": "vgt", "count": 2, "width": 0.2, "lengths": [0.2, 0.25]}
    arm = read(described(truss, REVOLUTE, PRISMATIC, {**PLATFORM, "count": 2}, LISTED)).manipulator
    assert (arm.dimension, arm.states.tolist()) == (3, [8, 8, 2, 3, 64, 64, 2])
    assert_allclose(arm.modules[4].frames, platform(BASE, TOP, (0.18, 0.22)).frames, atol=0)
    assert [name for name in arm.actuators if name.startswith("5.")] == [f"5.{k}" for k in range(1, 7)]
    states = [7, 1, 1, 2, 63, 5, 1]
    product = np.linalg.multi_dot([m.frames[s] for m, s in zip(arm.modules, states, strict=True)])
    assert_allclose(arm.tip(states), product, atol=1e-12)
    assert arm.configuration(arm.actuator_states(states)).tolist() == states


@pytest.mark.parametrize(
    ("module", "expected"),
    [
        ({**REVOLUTE, "axis": [0, 0, 0]}, ".axis: a direction is needed, got [0.0, 0.0, 0.0]"),
        ({**REVOLUTE, "axis": [0, 1]}, ".axis: Expected `array` of length >= 3 (given: [0, 1])"),
        ({**REVOLUTE, "angles": [0.2]}, ".angles: Expected `array` of length >= 2 (given: [0.2])"),
        ({**REVOLUTE, "angles": [-15, 0]}, ".angles[1]: Expected `float` >= -12.5664 (given: -15)"),
        ({**REVOLUTE, "angles": [0.1, 0.2, 0.1]}, ".angles: 0.1 occurs twice"),
        ({**REVOLUTE, "angles": [0.1, math.nan]}, ".angles[2]: nan is not a finite number"),
        (
            {**REVOLUTE, "link": {"position": [0, 0, 1], "orientation": 0.5}},
            ".link.orientation: a spatial frame needs a quaternion x, y, z, w, got the angle 0.5",
        ),
        ({**REVOLUTE, "code": "binary"}, ".code: unknown field; known are angles, axis, count, cylinders, link, type"),
        ({**PRISMATIC, "axis": [0, 0]}, ".axis: a direction is needed, got [0.0, 0.0]"),
        ({**PRISMATIC, "lengths": [0.1]}, ".lengths: Expected `array` of length >= 2 (given: [0.1])"),
        ({**PRISMATIC, "lengths": [0.1, 0.3, 0.2]}, ".lengths: 0.2 after 0.3, but each must be greater than the last"),
        ({"type": "prismatic", "lengths": [0.1, 0.2]}, ".axis: required, but missing"),
        ({**PLATFORM, "lengths": [0.22, 0.18]}, ".lengths: 0.22 contracted, so not 0.18 extended"),
        ({**PLATFORM, "top": TOP[:2]}, ".top: Expected `array` of length >= 3"),
        (
            {**PLATFORM, "top": TOP[:5]},
            ".top: 5 joints of 3 coordinates, but platforms have 6 of 3 coordinates, 3 of 3 coordinates, 3 of 2",
        ),
        (
            {**PLATFORM, "base": [*BASE[:5], [0, 0]]},
            ".base: 6 joints of 2 and 3 coordinates, but platforms have 6 of 3",
        ),
        ({**PLATFORM, "top": TOP[::2]}, ".top: three in space, but the joints of base are six in space"),
        ({**PLATFORM, "lengths": [0.15, 0.4]}, ": extended legs "),
        ({**PLATFORM, "top": BASE}, ": all legs in the middle of their travel: the plate is loose"),
        ({"type": "transforms"}, ": either states or table is needed, got neither"),
        ({**LISTED, "table": "a.csv"}, ": either states or table is needed, got both"),
        ({"type": "transforms", "table": "none.csv"}, ".table: none.csv cannot be read: No such file or directory"),
        ({"type": "transforms", "table": "../a.csv"}, ".table: a CSV file beside the arm's is needed, such as"),
        ({"type": "transforms", "table": "/a.csv"}, ".table: a CSV file beside the arm's is needed, such as"),
        ({"type": "transforms", "table": "arm.yaml"}, ".table: a CSV file beside the arm's is needed, such as"),
        ({"type": "hinge"}, ".type: 'hinge' is unknown; it must be one of vgt, "),
    ],
    ids=lambda value: str(value)[:40],
)
def test_each_fault_is_named_by_its_field(read, module, expected):
    with pytest.raises(InputFaults) as caught:
        read(described(LISTED, module))
    (fault,) = caught.value.faults
    assert fault.startswith(f"modules[2]{expected}")


def test_faults_of_all_types_come_together(read):
    groups = [{**REVOLUTE, "axis": [0, 0, 0]}, {**PRISMATIC, "lengths": [2, 1]}, {**PLATFORM, "top": BASE}]
    with pytest.raises(InputFaults) as caught:
        read(described(*groups, {"type": "transforms"}))
    assert [fault.split(":")[0] for fault in caught.value.faults] == [
        "modules[1].axis",
        "modules[2].lengths",
        "modules[3]",
        "modules[4]",
    ]


def test_a_table_lies_beside_the_arms_file(tmp_path: Path):
    (tmp_path / "measured").mkdir()
    (tmp_path / "measured" / "gripper.csv").write_text("x,y,th\n0,0.1,0\n0.01,0.1,0.2\n0,0.12,0\n")
    table = {"type": "transforms", "table": "measured/gripper.csv", "count": 2}
    (tmp_path / "arm.yaml").write_text(yaml.safe_dump(described(table)))
    arm = load(tmp_path / "arm.yaml").manipulator
    assert (arm.planar, arm.states.tolist(), arm.actuators) == (True, [3, 3], ("1.1", "1.2", "2.1", "2.2"))
    assert_allclose(arm.frames[0, 1], frames.planar(0.01, 0.1, 0.2), atol=0)


def test_cylinders_in_series_are_read_from_the_file_and_named(read):
    entry = {
        "type": "prismatic",
        "axis": [0, 1],
        "cylinders": [[0.2, 0.25], [0.2, 0.3]],
        "link": {"position": [0, 0.1]},
    }
    arm = read({"name": "a", "modules": [entry], "tolerance": {"position": 0.01}})
    assert arm.manipulator.actuators == ("1.1", "1.2")
    assert_allclose(arm.manipulator.tips([[k] for k in range(4)])[:, 1, 3], [0.5, 0.6, 0.55, 0.65])


@pytest.mark.parametrize(
    ("fields", "fault"),
    [
        ({"angles": [0, 1], "cylinders": [[0, 1]]}, "either angles or cylinders are needed, got both"),
        ({}, "either angles or cylinders are needed, got neither"),
        ({"cylinders": [[0.5, 0.5]]}, "the cylinder does nothing"),
    ],
)
def test_a_joint_has_angles_or_cylinders(read, fields, fault):
    with pytest.raises(InputFaults, match=fault):
        read({"name": "a", "modules": [{"type": "revolute", **fields}], "tolerance": {"position": 0.01}})
