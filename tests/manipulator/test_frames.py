"""Frames form a group; conversions are inverse to each other."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from hyperbit.controller.manipulator import frames
from hyperbit.controller.manipulator.frame_kernels import compose
from tests.arms import angles, any_frames, coordinates, planar_frames, quaternions, spatial_frames

TIGHT = {"atol": 1e-12}


@given(any_frames, any_frames, any_frames)
def test_composition_is_associative(f, g, h):
    assert_allclose((f @ g) @ h, f @ (g @ h), **TIGHT)


@given(any_frames)
def test_inverse_undoes_from_both_sides(f):
    assert_allclose(frames.inverse(f) @ f, np.eye(4), **TIGHT)
    assert_allclose(f @ frames.inverse(f), np.eye(4), **TIGHT)


@given(any_frames, any_frames)
def test_inverse_of_a_product_is_the_product_of_inverses_reversed(f, g):
    assert_allclose(frames.inverse(f @ g), frames.inverse(g) @ frames.inverse(f), **TIGHT)


@given(any_frames, any_frames, st.booleans())
def test_the_kernel_of_the_product_writes_it_beside_its_factor_or_over_it(f, g, over):
    (r, b), (s, c) = ((np.ascontiguousarray(x[:3, :3]), np.ascontiguousarray(x[:3, 3])) for x in (f, g))
    turned, moved = (r, b) if over else (np.empty((3, 3)), np.empty(3))
    compose(r, b, s, c, turned, moved)
    assert_allclose(np.c_[turned, moved], (f @ g)[:3], **TIGHT)


@given(any_frames, any_frames)
def test_a_product_is_again_a_frame(f, g):
    product = f @ g
    assert_allclose(product[:3, :3] @ product[:3, :3].T, np.eye(3), **TIGHT)
    assert np.linalg.det(product[:3, :3]) == pytest.approx(1)
    assert_allclose(product[3], [0, 0, 0, 1], **TIGHT)


@given(any_frames, any_frames)
def test_inverse_takes_a_batch_of_any_shape(f, g):
    batch = np.array([[f, g], [g, f]])
    assert_allclose(frames.inverse(batch)[1, 0], frames.inverse(g), atol=0)
    assert_allclose(frames.inverse(batch)[1, 1], frames.inverse(f), atol=0)


@given(planar_frames, planar_frames)
def test_planar_frames_stay_in_the_plane_and_add_their_angles(f, g):
    product = f @ g
    assert_allclose(product[2], [0, 0, 1, 0], atol=0)
    difference = frames.angle(product) - frames.angle(f) - frames.angle(g)
    assert math.remainder(difference, 2 * math.pi) == pytest.approx(0, abs=1e-9)


@given(coordinates, coordinates, angles)
def test_a_planar_frame_reads_back(x, y, angle):
    frame = frames.planar(x, y, angle)
    assert (frame[0, 3], frame[1, 3]) == (x, y)
    assert math.remainder(frames.angle(frame) - angle, 2 * math.pi) == pytest.approx(0, abs=1e-12)


def test_angles_are_counter_clockwise():
    assert_allclose(frames.planar(0, 0, math.pi / 2)[:3, :3] @ [1, 0, 0], [0, 1, 0], **TIGHT)


@given(quaternions)
def test_a_quaternion_reads_back_with_w_positive(quaternion):
    unit = np.array(quaternion) / np.linalg.norm(quaternion)
    back = frames.quaternion(frames.spatial((0, 0, 0), quaternion))
    assert back[3] >= 0
    assert_allclose(back * np.sign(back @ unit), unit, atol=1e-9)


@given(spatial_frames)
def test_a_frame_is_rebuilt_from_position_and_quaternion(f):
    assert_allclose(frames.spatial(f[:3, 3], frames.quaternion(f)), f, atol=1e-9)


@pytest.mark.parametrize("axis", range(3))
def test_a_half_turn_has_a_quaternion(axis):
    quaternion = np.eye(4)[axis]
    assert_allclose(np.abs(frames.quaternion(frames.spatial((1, 2, 3), quaternion))), quaternion, **TIGHT)
