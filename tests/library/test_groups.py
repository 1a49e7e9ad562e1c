"""Groups and units of arms built in code."""

import numpy as np
import pytest

import hyperbit as hb

SEGMENT = [
    hb.prismatic((0, 1), cylinders=[(0, 25), (0, 50)], link=(0, 60)),
    hb.revolute(np.radians([-30, 30]), link=(0, 40)),
]


def test_a_group_is_the_list_repeated_and_shares_its_numbers() -> None:
    arm, plain = hb.Arm([hb.group(SEGMENT, 10)], unit="mm"), hb.Arm(SEGMENT * 10)
    configurations = arm.sample(30, seed=1)
    assert np.array_equal(arm.frames(configurations), plain.frames(configurations))
    fitted = hb.calibrate(arm, configurations, plain.frames(configurations)[:, :2, 3] + (3, -5))
    assert len(fitted.report.changes) == 15
    assert fitted.arm.unit == "mm"
    only = hb.calibrate(arm, configurations, plain.frames(configurations)[:, :2, 3] + (3, -5), fit=())
    assert len(only.report.changes) == 3
    assert only.report.better


def test_a_wrong_group_or_unit_is_told() -> None:
    with pytest.raises(hb.ArmError, match="'group' is unknown; it must be one of vgt, revolute"):
        hb.group([hb.group(SEGMENT, 2)], 2)
    with pytest.raises(hb.ArmError, match="count"):
        hb.group(SEGMENT, 0)
    with pytest.raises(hb.ArmError, match="unit: 'ft' is unknown; it must be one of m, cm, mm, in"):
        hb.Arm(SEGMENT, unit="ft")


def test_an_arm_without_a_unit_names_none() -> None:
    assert hb.Arm(SEGMENT).unit is None
    assert hb.plot(hb.Arm(SEGMENT), density=False).axes[0].get_xlabel() == "x [unit of the arm's file]"
    assert hb.plot(hb.Arm(SEGMENT), density=False, unit="cm").axes[0].get_xlabel() == "x [cm]"
