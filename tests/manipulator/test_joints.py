"""Joints of several positions, against closed forms."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from hyperbit.controller.manipulator import frames
from hyperbit.controller.manipulator.joints import prismatic, revolute, summed
from hyperbit.controller.manipulator.manipulator import Manipulator
from hyperbit.controller.manipulator.module import binary_code, gray_code
from tests.arms import any_frames, coordinates, spatial_frames

TIGHT = {"atol": 1e-12}
turns = st.lists(st.floats(-2 * np.pi, 2 * np.pi), min_size=2, max_size=20)
axes = st.lists(coordinates, min_size=3, max_size=3).filter(lambda axis: np.linalg.norm(axis) > 0.1)
LINK = frames.planar(0.0, 0.5)


@given(st.integers(2, 300))
def test_neighbours_in_gray_code_differ_in_one_actuator(states):
    bits = gray_code(states)
    assert bits.shape == binary_code(states).shape
    assert (np.abs(np.diff(bits.astype(int), axis=0)).sum(axis=1) == 1).all()
    place = np.arange(states)
    assert (bits @ (1 << np.arange(bits.shape[1])[::-1])).tolist() == (place ^ (place >> 1)).tolist()


@given(turns)
def test_a_joint_in_the_plane_in_closed_form(angles):
    module = revolute((0, 0, 1), angles, LINK)
    assert module.planar
    for frame, angle in zip(module.frames, angles, strict=True):
        assert_allclose(frame, frames.planar(-0.5 * math.sin(angle), 0.5 * math.cos(angle), angle), **TIGHT)
    assert_allclose(module.body[:, 0, 1], module.frames[:, :3, 3], **TIGHT)


@given(st.lists(st.integers(0, 3), min_size=1, max_size=8))
def test_a_chain_of_joints_adds_its_angles(states):
    angles = (-0.7, -0.1, 0.4, 1.1)
    chain = Manipulator([revolute((0, 0, 1), angles, LINK)] * len(states))
    headings = np.cumsum([angles[state] for state in states])
    position = 0.5 * np.array([-np.sin(headings).sum(), np.cos(headings).sum()])
    assert_allclose(chain.tip(states), frames.planar(*position, headings[-1]), **TIGHT)


@given(axes, turns, any_frames)
def test_turning_about_any_axis(axis, angles, link):
    unit = np.array(axis) / np.linalg.norm(axis)
    cross = np.cross(np.eye(3), unit)
    for frame, angle in zip(revolute(axis, angles, link).frames, angles, strict=True):
        # Rodrigues' formula
        rotation = np.eye(3) + math.sin(angle) * cross + (1 - math.cos(angle)) * cross @ cross
        assert_allclose(frame[:3, :3], rotation @ link[:3, :3], **TIGHT)
        assert_allclose(frame[:3, 3], rotation @ link[:3, 3], **TIGHT)
    assert_allclose(revolute(-unit, np.negative(angles), link).frames, revolute(axis, angles, link).frames, **TIGHT)


@given(axes, st.lists(coordinates, min_size=2, max_size=9), spatial_frames)
def test_sliding_along_any_axis(axis, lengths, link):
    unit = np.array(axis) / np.linalg.norm(axis)
    for frame, length in zip(prismatic(axis, lengths, link).frames, lengths, strict=True):
        assert_allclose(frame[:3, 3], length * unit + link[:3, 3], **TIGHT)
        assert_allclose(frame[:3, :3], link[:3, :3], atol=0)


@pytest.mark.parametrize(
    ("module", "planar"),
    [
        (revolute((0, 0, 1), (-1, 1), LINK), True),
        (revolute((0, 0, -2), (-1, 1), LINK), True),
        (revolute((0, 0, 1), (-1, 1), frames.spatial((0, 1, 0.1))), False),
        (revolute((0, 1e-9, 1), (-1, 1), LINK), False),
        (prismatic((1, 1, 0), (0, 1), np.eye(4)), True),
        (prismatic((1, 1, 0), (0, 1), frames.spatial((0, 0, 0), (1, 0, 0, 1))), False),
        (prismatic((0, 0, 1), (0, 1), np.eye(4)), False),
    ],
)
def test_what_stays_in_the_plane_is_planar(module, planar):
    assert module.planar is planar


def test_actuators_spell_the_position():
    module = revolute((0, 0, 1), np.linspace(-0.4, 0.4, 16), LINK)
    assert module.actuators == ("1", "2", "3", "4")
    assert module.bits[[0, 1, 2, 15]].tolist() == [[0, 0, 0, 0], [0, 0, 0, 1], [0, 0, 1, 1], [1, 0, 0, 0]]
    arm = Manipulator([module] * 2)
    assert arm.switches([7, 3], [8, 4]) == 2
    assert arm.configuration([1, 0, 0, 0, 0, 0, 1, 1]).tolist() == [15, 2]


@given(st.lists(st.tuples(coordinates, coordinates), min_size=1, max_size=4), st.integers(0, 2**32 - 1))
def test_cylinders_in_series_add_their_values_also_in_mid_travel(cylinders, seed):
    values, bits = summed(cylinders), binary_code(1 << len(cylinders))
    assert_allclose(values, [sum(pair[bit] for pair, bit in zip(cylinders, own, strict=True)) for own in bits], **TIGHT)
    module = revolute((0, 0, 1), values, LINK, bits)
    between = np.random.default_rng(seed).random((1, len(cylinders)))
    angle = sum(low + share * (high - low) for (low, high), share in zip(cylinders, between[0], strict=True))
    assert_allclose(
        module.between(between)[0][0], frames.planar(-0.5 * math.sin(angle), 0.5 * math.cos(angle), angle), **TIGHT
    )
    assert module.actuators == tuple(str(k + 1) for k in range(len(cylinders)))
