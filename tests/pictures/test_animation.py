"""Animations: a frame for each part of a stroke, everything inside, in the format of the file's suffix."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from PIL import Image

from hyperbit.controller.commands.operate.demo import Watched
from hyperbit.controller.pictures.animation import END, FRAME, PAUSE, SHARES, Movement, body_of, film, tip_of
from hyperbit.controller.pictures.plots import Subplot, figure
from tests.arms import spatial_arm


@pytest.mark.parametrize("suffix", ["gif", "png", "webp"])
def test_an_animation_has_a_frame_for_each_part_of_a_stroke(manipulator, densities, tmp_path, suffix):
    file = tmp_path / f"arm.{suffix}"
    states = np.zeros((3, len(manipulator.actuators)), dtype=int)
    states[1, :6], states[2, :12] = 1, 1
    shown = figure(manipulator, densities, [Subplot("arm", targets=[(0.55, 2.9)])])
    film(shown, manipulator, Movement(states, [2])).write(file)
    with Image.open(file) as image:
        assert image.n_frames == 1 + 2 * len(SHARES)
        if suffix == "gif":
            durations = []
            for k in range(image.n_frames):
                image.seek(k)
                durations.append(image.info["duration"])
            parts = len(SHARES) - 1
            assert durations == [END, *[FRAME] * parts, END, *[FRAME] * parts, PAUSE]


def test_a_spatial_arm_is_drawn(tmp_path):
    arm = spatial_arm(4)
    states = [arm.actuator_states(np.full(len(arm.modules), k)) for k in (0, 1)]
    film(figure(arm, None, [Subplot("arm")]), arm, Movement(states)).write(tmp_path / "arm.gif")
    assert (tmp_path / "arm.gif").stat().st_size > 1000


def test_at_the_ends_of_a_stroke_the_arm_is_drawn_as_its_configuration(manipulator):
    configuration = np.arange(16) % 8
    states = manipulator.actuator_states(configuration).astype(float)
    assert_allclose(body_of(manipulator, states), manipulator.body(configuration), atol=1e-12)
    assert_allclose(tip_of(manipulator, states), manipulator.tip(configuration)[:3, 3], atol=1e-12)


def test_states_are_noted_as_they_change():
    watched = Watched()
    for commanded in (None, [0, 0], [0, 0], [0, 1], None, [0, 0]):
        watched.receive_state({"commanded": commanded})
    assert watched == [[0, 0], [0, 1], [0, 0]]
    assert watched.find([0, 0]) == 2
