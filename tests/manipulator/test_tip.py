"""A tool at the tip: forward kinematics, mid-travel, search, collisions and the arm's file."""

import pickle

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

import hyperbit as hb
from hyperbit.controller.arm.description import description
from hyperbit.controller.armfile.strict import InputFaults
from hyperbit.controller.manipulator.frames import angle, angle_between, inverse, planar, spatial
from hyperbit.controller.manipulator.manipulator import Manipulator
from hyperbit.controller.manipulator.module import tipped
from tests.arm_files import document
from tests.arms import any_frames, every_configuration, modules, short_arms
from tests.manipulator.test_platform import KINDS, platform_of

TOOL = planar(0.05, 0.3, 0.4)


def bare_and_tooled(bare: Manipulator, tip: np.ndarray) -> Manipulator:
    return Manipulator([*bare.modules[:-1], tipped(bare.modules[-1], tip)], bare.base)


@given(short_arms(most=3), any_frames)
def test_tips_are_those_of_the_tool(bare, tip):
    tooled, every = bare_and_tooled(bare, tip), every_configuration(bare)
    assert_allclose(tooled.tips(every), bare.tips(every) @ tip, atol=1e-12)
    for configuration in every[:20]:
        tool = tooled.body(configuration)[-1]
        assert_allclose(tool[0], bare.tip(configuration)[:3, 3], atol=1e-12)
        assert_allclose(tool[1], tooled.tip(configuration)[:3, 3], atol=1e-12)


@settings(max_examples=60)
@given(modules, any_frames, st.lists(st.floats(0, 1), min_size=6, max_size=6), st.integers(0, 2**32 - 1))
def test_a_tool_stays_within_its_bounds_in_mid_travel(bare, tip, values, seed):
    module, count = pickle.loads(pickle.dumps(tipped(bare, tip))), len(bare.actuators)
    frames, body = module.between(module.bits.astype(float))
    assert_allclose(frames, module.frames, atol=1e-12)
    assert_allclose(body, module.body, atol=1e-12)
    moving, fixed = np.arange(count), module.bits[0].astype(float)
    bounds = module.bounds(fixed, moving)
    assert not np.isnan(bounds).any()
    if not np.isfinite(bounds).all():
        return
    first, second = np.array(values[:count]), np.random.default_rng(seed).random(count)
    frames, body = module.between(np.stack([first, second]))
    move, turn, drawn = abs(second - first) @ bounds
    assert np.linalg.norm(frames[1, :3, 3] - frames[0, :3, 3]) <= move + 1e-9
    assert angle_between(frames[0, :3, :3], frames[1, :3, :3]) <= turn + 1e-6
    assert np.linalg.norm(body[1] - body[0], axis=-1).max() <= drawn + 1e-9


@pytest.mark.parametrize("kind", KINDS)
def test_a_platform_carries_a_tool(kind):
    bare = platform_of(kind)
    module = tipped(bare, TOOL)
    assert not module.proven
    middle = np.full((1, len(bare.actuators)), 0.5)
    assert_allclose(module.between(middle)[0], bare.between(middle)[0] @ TOOL, atol=1e-12)


def trusses(**more: object) -> hb.Arm:
    return hb.Arm([hb.vgt("BC", width=0.2, lengths=(0.2, 0.25), count=4)], pixel=0.02, **more)


@pytest.mark.parametrize("oriented", [False, True])
def test_goals_are_of_the_tool(oriented):
    arm, bare = trusses(tip=TOOL), trusses()
    solver, rng = hb.Solver(arm), np.random.default_rng(3)
    manipulator = arm._arm.manipulator
    every = every_configuration(manipulator)
    tips = manipulator.tips(every)
    for hidden in rng.integers(0, 8, (12, 4)):
        wanted = bare.frame(hidden) @ TOOL
        turned = {"orientation": angle(wanted), "angle_tolerance": 1e-5} if oriented else {}
        goal = hb.Goal(wanted[:2, 3], tolerance=1e-6, **turned)
        found = solver.solve(goal, start=arm.home)
        assert found.within_tolerance
        assert np.linalg.norm(arm.position(found.configuration) - wanted[:2, 3]) <= 1e-6
        serves = np.linalg.norm(tips[:, :2, 3] - wanted[:2, 3], axis=1) <= 1e-6
        if oriented:
            serves &= np.array([angle_between(tip[:3, :3], wanted[:3, :3]) <= 1e-5 for tip in tips])
        fewest = min(manipulator.switches(arm.home, each) for each in every[serves])
        assert found.switches == fewest


def test_a_tool_collides():
    arm = trusses(tip=(0.0, 0.5))
    place = arm.position(arm.home) - (0.0, 0.2)
    near = trusses(tip=(0.0, 0.5), obstacles=[hb.Disc(place, 0.05, name="lamp")])
    clear = trusses(obstacles=[hb.Disc(place, 0.05, name="lamp")])
    assert "lamp" in str(near._arm.clearance().where(arm.home))
    assert clear._arm.clearance().where(arm.home) is None


def test_a_tip_is_read_from_the_arms_file(read):
    bare = read(document())
    value = {**document(), "tip": {"position": [0.1, 0.2], "orientation": 0.3}}
    arm, home = read(value), np.zeros(len(bare.manipulator.modules), dtype=int)
    assert_allclose(arm.tip, planar(0.1, 0.2, 0.3))
    assert_allclose(arm.manipulator.tip(home), bare.manipulator.tip(home) @ arm.tip)
    assert_allclose(description(arm).tip, arm.tip)
    assert_allclose(description(bare).tip, np.eye(4))
    assert arm.digest != bare.digest
    assert_allclose(inverse(arm.tip) @ arm.tip, np.eye(4), atol=1e-12)


def test_a_tip_out_of_the_plane_makes_the_arm_spatial():
    assert trusses(tip=spatial((0, 0.1, 0.2))).dimension == 3
    assert trusses(tip=TOOL).dimension == 2


def test_a_wrong_tip_is_named(read):
    with pytest.raises(InputFaults, match=r"tip\.orientation: a quaternion"):
        read({**document(), "tip": {"position": [0, 0, 1], "orientation": [0, 0, 0, 2]}})
