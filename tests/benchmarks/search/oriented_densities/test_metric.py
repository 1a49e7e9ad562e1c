"""The distance of frames is a metric."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hyperbit.controller.manipulator import frames
from tests.arms import angles, any_frames, coordinates
from tests.benchmarks.search.oriented_densities.metric import distance


@given(any_frames, any_frames, any_frames, any_frames, st.floats(0, 5))
def test_the_distance_of_frames_is_a_metric_that_no_base_changes(f, g, h, base, weight):
    between = distance(f, g, weight)
    assert between == pytest.approx(distance(g, f, weight))
    assert between <= distance(f, h, weight) + distance(h, g, weight) + 1e-9
    assert between == pytest.approx(distance(base @ f, base @ g, weight), abs=1e-7)
    assert distance(f, f, weight) == pytest.approx(0, abs=1e-7)
    assert distance(f, g, 0) == pytest.approx(np.linalg.norm(f[:3, 3] - g[:3, 3]))


@given(coordinates, coordinates, angles, st.floats(0, 5))
def test_the_distance_weighs_the_angle_as_a_length(x, y, angle, weight):
    expected = math.sqrt(x * x + y * y + (weight * angle) ** 2)
    assert distance(np.eye(4), frames.planar(x, y, angle), weight) == pytest.approx(expected, abs=1e-6)
