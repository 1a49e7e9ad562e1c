"""Forward kinematics of the nine configurations that Figure 6 lists."""

import pytest

from hyperbit.controller.manipulator import frames
from hyperbit.controller.manipulator.notation import parse_configuration

# Octal digits base first, then x, y and orientation as printed. The printed error of IPOP-previous at the third
# target, 0.039, is a misprint.
FIGURE_6 = [
    ("4646676700771206", 3.000, 0.700, -1.621),
    ("0000045252516521", 0.550, 2.898, 0.039),
    ("0000052402222212", 0.397, 2.900, 0.000),
    ("4646006677161676", 2.998, 0.699, -1.845),
    ("4646313127236164", 0.550, 2.899, -0.264),
    ("4646313137167760", 0.401, 2.899, 0.039),
    ("4646006677161676", 2.998, 0.699, -1.845),
    ("0000000062061273", 0.550, 2.902, 0.039),
    ("0000000040257060", 0.398, 2.901, -0.567),
]


@pytest.mark.parametrize(("digits", "x", "y", "orientation"), FIGURE_6)
def test_tip_of_figure_6(manipulator, digits, x, y, orientation):
    tip = manipulator.tip(parse_configuration(manipulator, digits))
    assert (tip[0, 3], tip[1, 3], frames.angle(tip)) == pytest.approx((x, y, orientation), abs=0.001)
