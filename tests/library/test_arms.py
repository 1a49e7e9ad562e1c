"""Arms from files and from code."""

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import cKDTree

import hyperbit as hb
from hyperbit.controller.arm import arm as config
from hyperbit.controller.arm.weights import weights_of
from tests.arms import every_configuration, paper_arm

DEPLOY = Path(__file__).parents[2] / "deploy"


def test_an_arm_in_code_is_that_of_the_paper(arm: hb.Arm) -> None:
    whole = paper_arm(4)
    every = every_configuration(whole)
    np.testing.assert_allclose(arm.frames(every), whole.tips(every), atol=1e-12)
    assert arm.actuators == whole.actuators
    assert (arm.name, arm.dimension, arm.tolerance, arm.locked) == ("short", 2, 0.01, {})
    assert arm.states.tolist() == [8] * 4
    assert arm.home.tolist() == [0] * 4


def test_a_file_gives_the_arm_that_commands_load() -> None:
    arm, loaded = hb.load(DEPLOY / "planar16.yaml"), config.load(DEPLOY / "planar16.yaml")
    states = np.arange(16) % 8
    np.testing.assert_array_equal(arm.frame(states), loaded.manipulator.tip(states))
    np.testing.assert_array_equal(arm.weights, weights_of(loaded))
    assert arm.format(states) == "0123456701234567"
    np.testing.assert_array_equal(arm.parse("0123456701234567"), states)


def test_modules_of_every_kind_make_one_chain() -> None:
    corner = np.eye(4)
    corner[:3, 3] = 0.1, 0.2, 0.0
    joints = [(0.15, 0, 0), (-0.075, 0.13, 0), (-0.075, -0.13, 0)]
    arm = hb.Arm(
        [
            hb.revolute([-0.3, 0.3], link=(0.0, 0.2)),
            hb.prismatic((0, 1), [0.1, 0.2], link=corner),
            hb.transforms([np.eye(4), corner], count=2),
            hb.platform(joints, joints, (0.18, 0.22)),
        ],
        base=(1.0, 2.0, 0.5),
    )
    assert arm.dimension == 3
    assert arm.states.tolist() == [2, 2, 2, 2, 8]
    without = arm.frame([0, 0, 0, 0, 0])
    with_corners = arm.frame([0, 0, 1, 1, 0])
    moved = with_corners[:3, 3] - without[:3, 3]
    assert np.linalg.norm(moved) == pytest.approx(2 * np.linalg.norm(corner[:3, 3]))


def test_actuator_states_and_back(arm: hb.Arm) -> None:
    for configuration in arm.sample(5):
        states = arm.actuator_states(configuration)
        assert states.shape == (12,)
        np.testing.assert_array_equal(arm.configuration(states), configuration)
    assert arm.switches(arm.home, [7, 7, 7, 7]) == 12
    np.testing.assert_array_equal(arm.sample(3, seed=4), arm.sample(3, seed=4))


def test_locked_actuators_keep_their_states(arm: hb.Arm) -> None:
    locked = arm.lock({"2.left": "extended", "3.right": "contracted"})
    assert arm.locked == {}
    assert locked.locked == {"2.left": "extended", "3.right": "contracted"}
    assert locked.home.tolist() == [0, 4, 0, 0]
    left, right = arm.actuators.index("2.left"), arm.actuators.index("3.right")
    states = np.array([locked.actuator_states(row) for row in locked.sample(50)])
    assert (states[:, left] == 1).all()
    assert (states[:, right] == 0).all()
    assert locked.lock({"2.left": None}).locked == {"3.right": "contracted"}


def test_density_counts_every_configuration(arm: hb.Arm) -> None:
    density = arm.density()
    assert density.total == pytest.approx(np.log(8**4), rel=0.01)
    assert arm.lock({"1.left": "extended"}).density().total == pytest.approx(np.log(8**4 / 2), rel=0.01)
    tips = arm.frames(arm.sample(200))[:, :2, 3]
    assert (density.at(tips) > 0).mean() > 0.8
    assert density.at(tips[0]).shape == ()
    assert density.at([100.0, 100.0]) == 0


def test_density_is_placed_with_the_base(arm: hb.Arm) -> None:
    turned = np.array([[0.0, -1, 0, 3], [1, 0, 0, 4], [0, 0, 1, 0], [0, 0, 0, 1]])
    other = hb.Arm([hb.vgt("BC", width=0.2, lengths=(0.2, 0.25), count=4)], base=turned)
    rows = arm.sample(100)
    here, there = arm.frames(rows)[:, :2, 3], other.frames(rows)[:, :2, 3]
    same = arm.density().at(here) == other.density().at(there)
    assert same.mean() > 0.95, "tips on the edge of a pixel may be rounded to its neighbour"


def test_density_of_a_spatial_arm() -> None:
    turns = [hb.revolute([-0.5, 0.5], axis=axis, link=(0.0, 0.0, 0.2), count=3) for axis in ((1, 0, 0), (0, 1, 0))]
    arm = hb.Arm(turns, pixel=0.05)
    density = arm.density()
    assert density.log_counts.ndim == 3
    assert density.origin.shape == (3,)
    assert density.total == pytest.approx(np.log(2**6), rel=0.02)
    assert (density.at(arm.frames(arm.sample(50))[:, :3, 3]) > 0).mean() > 0.8


@pytest.mark.parametrize("turn", [0.0, 0.7])
def test_the_map_of_reach_has_the_tips_in_their_places(turn: float) -> None:
    base = np.eye(4)
    base[:2, :2], base[:2, 3] = [[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]], (3, 4)
    arm = hb.Arm([hb.vgt("BC", width=0.2, lengths=(0.2, 0.25), count=4)], base=base, tolerance=0.01)
    reach, tips = arm.reach(), arm.position(every_configuration(paper_arm(4)))
    (left, right, bottom, top), (rows, columns) = reach.extent, reach.reached.shape
    assert (right - left, top - bottom) == pytest.approx((columns * reach.pixel, rows * reach.pixel))
    assert np.log10((10**reach.log10_counts).sum()) == pytest.approx(4 * np.log10(8), rel=1e-6)
    x = left + reach.pixel * (np.arange(columns) + 0.5)
    y = bottom + reach.pixel * (np.arange(rows) + 0.5)
    centres = np.stack(np.meshgrid(x, y), axis=-1)
    distance, error = cKDTree(tips).query(centres)[0], 2 * reach.pixel
    assert not (reach.reached & (distance > arm.tolerance + error)).any()
    assert reach.reached[distance < arm.tolerance - error].all()
    assert arm.reach(0.02).reached.sum() > reach.reached.sum() > arm.reach(0.001).reached.sum() > 0
    assert "Reach(" in repr(reach)


def test_the_map_of_reach_of_a_spatial_arm() -> None:
    turns = [hb.revolute([-0.5, 0.5], axis=axis, link=(0.0, 0.0, 0.2), count=3) for axis in ((1, 0, 0), (0, 1, 0))]
    arm = hb.Arm(turns, pixel=0.05, base=(1, 2, 3))
    reach, tips = arm.reach(0.05), arm.position(arm.sample(50))
    assert len(reach.extent) == 6
    place = np.floor((tips - reach.extent[::2]) / reach.pixel).astype(int)
    assert reach.reached[tuple(place[:, ::-1].T)].mean() > 0.8
    with pytest.raises(hb.GoalError, match="radius"):
        arm.reach(0)


def test_coverage_respects_locked_actuators(arm: hb.Arm) -> None:
    free, locked = arm.coverage(), arm.lock({"1.left": "extended"}).coverage()
    assert free.log10_configurations == pytest.approx(4 * np.log10(8))
    assert locked.area.upper < free.area.lower
    assert arm.coverage(0.02).area.lower > free.area.upper
    with pytest.raises(hb.GoalError):
        arm.coverage(0.0)


def test_orientations_and_locked_reach(arm: hb.Arm) -> None:
    point = arm.position(arm.sample(1, seed=3)[0])
    found = arm.orientations(point, 0.01)
    rows = np.array(list(np.ndindex(*arm.states)))
    near = np.linalg.norm(arm.frames(rows)[:, :2, 3] - point, axis=1) <= 0.01
    assert found.total == near.sum() == len(found.rotations)
    reach = arm.locked_reach(1)
    assert len(reach.choices) == 2 * len(arm.actuators)
    assert reach.worst("reach").reach <= reach.mean("reach") <= reach.free.reach * 1.05
    with pytest.raises(hb.GoalError):
        arm.orientations((0.0, 0.0, 0.0))
    with pytest.raises(hb.LockError):
        arm.locked_reach(99)
