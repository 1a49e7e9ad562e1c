"""Modules: the states of the truss of section 4, and modules of listed frames."""

import math
import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from hyperbit.controller.manipulator import frames
from hyperbit.controller.manipulator.module import binary_code, transforms
from hyperbit.controller.manipulator.vgt import vgt
from tests.arms import lengths

# x, y and orientation of the top frame for the states 0 to 7, paper-notes' table.
ODD = [
    (0.1000, 0.1732, 0),
    (0.0954, 0.2030, 0.3031),
    (0.0438, 0.1952, 0),
    (0.0403, 0.2212, 0.2636),
    (0.1517, 0.1653, -0.3031),
    (0.1562, 0.1952, 0),
    (0.0965, 0.2031, -0.2636),
    (0.1000, 0.2291, 0),
]
EVEN = [
    (-0.1000, 0.1732, 0),
    (-0.1517, 0.1653, 0.3031),
    (-0.0438, 0.1952, 0),
    (-0.0965, 0.2031, 0.2636),
    (-0.0954, 0.2030, -0.3031),
    (-0.1562, 0.1952, 0),
    (-0.0403, 0.2212, -0.2636),
    (-0.1000, 0.2291, 0),
]


@pytest.mark.parametrize(("diagonal", "table"), [("BC", ODD), ("AD", EVEN)])
def test_the_papers_modules(diagonal, table):
    module = vgt(diagonal, 0.2, *[(0.2, 0.25)] * 3)
    found = [(f[0, 3], f[1, 3], frames.angle(f)) for f in module.frames]
    assert_allclose(found, table, atol=0.5001e-4)


@given(st.sampled_from(["BC", "AD"]), st.floats(0.18, 0.22), lengths, lengths, lengths)
def test_every_state_has_the_lengths_it_stands_for(diagonal, width, left, middle, right):
    module = vgt(diagonal, width, left, middle, right)
    brace = ("b", "c") if diagonal == "BC" else ("a", "d")
    for frame, (bit_left, bit_middle, bit_right) in zip(module.frames, module.bits, strict=True):
        node = {"a": np.array([-width / 2, 0, 0]), "b": np.array([width / 2, 0, 0])}
        node["c"], node["d"] = (frame @ [-width / 2, 0, 0, 1])[:3], (frame @ [width / 2, 0, 0, 1])[:3]
        for (p, q), length in [("ac", left[bit_left]), (brace, middle[bit_middle]), ("bd", right[bit_right])]:
            assert np.linalg.norm(node[p] - node[q]) == pytest.approx(length)
        assert frame[1, 3] > 0  # the top is on the side away from the base


@given(lengths, lengths, lengths)
def test_the_two_diagonals_are_mirror_images(left, middle, right):
    module, mirror = vgt("BC", 0.2, left, middle, right), vgt("AD", 0.2, right, middle, left)
    flip = np.diag([-1.0, 1, 1, 1])
    for frame, (bit_left, bit_middle, bit_right) in zip(module.frames, module.bits, strict=True):
        state = np.flatnonzero((mirror.bits == [bit_right, bit_middle, bit_left]).all(axis=1))[0]
        assert_allclose(mirror.frames[state], flip @ frame @ flip, atol=1e-12)


def test_bits_are_left_diagonal_right():
    module = vgt("BC", 0.2, *[(0.2, 0.25)] * 3)
    assert module.actuators == ("left", "diagonal", "right")
    assert module.bits[4].tolist() == [1, 0, 0]
    assert module.bits[3].tolist() == [0, 1, 1]


@pytest.mark.parametrize("diagonal", ["BC", "AD"])
@pytest.mark.parametrize(
    ("width", "left", "middle", "right", "named"),
    [
        (0.5, (0.2, 0.25), (0.2, 0.25), (0.2, 0.25), "width 0.5"),
        (0.2, (0.2, 0.9), (0.2, 0.25), (0.2, 0.25), "legs 0.9"),
        (0.2, (0.2, 0.25), (0.2, 0.25), (0.2, 0.9), "and 0.9"),
        (0.2, (0.2, 0.25), (0.2, 0.9), (0.2, 0.25), "diagonal 0.9"),
        (0.2, (0.1, 0.25), (0.1, 0.25), (0.1, 0.25), "sides 0.1 and 0.1 do not meet over a base of 0.2"),
    ],
)
def test_lengths_that_close_no_triangle_are_named(diagonal, width, left, middle, right, named):
    with pytest.raises(ValueError, match=re.escape(named)):
        vgt(diagonal, width, left, middle, right)


@given(st.integers(2, 300))
def test_a_binary_code_counts_with_no_bit_too_many(states):
    bits = binary_code(states)
    assert bits.shape[1] == math.ceil(math.log2(states))
    assert (bits @ (1 << np.arange(bits.shape[1])[::-1])).tolist() == list(range(states))


def test_a_listed_module_points_its_body_at_its_frames():
    states = [frames.spatial((0, 0, 1)), frames.spatial((0, 1, 0)), frames.spatial((1, 0, 0))]
    module = transforms(states, planar=False)
    assert module.actuators == ("1", "2")
    assert_allclose(module.body[:, 0], [[[0, 0, 0], f[:3, 3]] for f in states])
