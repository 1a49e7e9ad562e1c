"""Modules in mid-travel: the ends are the states, and the lengths of actuators follow the displacements."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from hyperbit.controller.manipulator.frames import angle, angle_between, planar, spatial
from hyperbit.controller.manipulator.joints import prismatic, revolute
from hyperbit.controller.manipulator.module import transforms
from hyperbit.controller.manipulator.vgt import vgt
from tests.arms import modules
from tests.manipulator.test_platform import KINDS, padded, platform_of

displacements = st.lists(st.floats(0, 1), min_size=6, max_size=6)
LEGS = (0.18, 0.22), (0.2, 0.25), (0.21, 0.26)


def legs(body: np.ndarray) -> np.ndarray:
    return np.linalg.norm(body[:, 1] - body[:, 0], axis=1)


def at_ends(module) -> None:
    frames, body = module.between(module.bits.astype(float))
    assert_allclose(frames, module.frames, atol=1e-12)
    assert_allclose(body, module.body, atol=1e-12)


@given(modules)
def test_displacements_at_their_ends_are_the_states(module):
    at_ends(module)


@pytest.mark.parametrize("kind", KINDS)
def test_platforms_at_their_ends_are_the_states(kind):
    at_ends(platform_of(kind))


@given(st.sampled_from(["BC", "AD"]), displacements)
def test_a_truss_is_as_long_as_its_displacements(diagonal, values):
    own = np.array(values[:3])
    frames, body = vgt(diagonal, 0.2, *LEGS).between(own[None])
    wanted = [low + s * (high - low) for s, (low, high) in zip(own, LEGS, strict=True)]
    assert_allclose(legs(body[0])[[0, 1, 2, 3]], [wanted[0], wanted[1], wanted[2], 0.2], atol=1e-12)
    top = body[0, 3]
    assert_allclose(frames[0, :3, 3], top.mean(axis=0), atol=1e-12)
    assert angle(frames[0]) == pytest.approx(math.atan2(*(top[1] - top[0])[1::-1]))


@settings(max_examples=30)
@given(st.sampled_from(sorted(KINDS)), displacements)
def test_a_platform_is_as_long_as_its_displacements(kind, values):
    base, top, (low, high) = KINDS[kind]
    module, own = platform_of(kind), np.array(values[: len(base)])
    frames, body = module.between(np.array([own, own[::-1]]))
    assert_allclose(legs(body[0])[: len(base)], low + own * (high - low), atol=1e-9)
    assert_allclose(body[0, : len(base), 1], padded(top) @ frames[0, :3, :3].T + frames[0, :3, 3], atol=1e-12)
    assert_allclose(body[1], module.between(own[None, ::-1])[1][0], atol=1e-12)


def test_a_joint_is_between_the_positions_that_may_be_read():
    joint = revolute((0, 0, 1), [-3.0, 0.0, 1.0, 3.0], planar(0.3, 0.0))  # codes 00, 01, 11, 10
    found = [angle(frame) for frame in joint.between(np.array([[0.0, 0.5], [0.5, 0.0], [0.5, 0.5]]))[0]]
    assert found == pytest.approx([-1.5, 0.0, 0.25])
    slide = prismatic((0, 0, 2), [0.1, 0.5], spatial((0.0, 0.2, 0.0)))
    frames, body = slide.between(np.array([[0.25]]))
    assert_allclose(frames[0, :3, 3], [0.0, 0.2, 0.2])
    assert_allclose(body[0, 0], [[0, 0, 0], [0.0, 0.2, 0.2]])


def test_listed_frames_are_blended_and_unknown_where_one_is_missing():
    turned = spatial((0.0, 0.0, 1.0), (math.sin(0.4), 0.0, 0.0, math.cos(0.4)))
    module = transforms([np.eye(4), spatial((1.0, 0.0, 0.0)), turned], planar=False)  # codes 00, 01, 10
    frames, body = module.between(np.array([[0.0, 0.25], [0.5, 0.0], [0.5, 0.5]]))
    assert_allclose(frames[0, :3, 3], [0.25, 0.0, 0.0])
    assert_allclose(body[0, 0, 1], [0.25, 0.0, 0.0])
    assert angle_between(frames[1], np.eye(4)) == pytest.approx(0.4)
    assert np.isnan(frames[2]).all()
    assert np.isnan(body[2]).all()
