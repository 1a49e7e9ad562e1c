"""Drawings of arms, and densities as pictures."""

import io

import numpy as np
import pytest
from matplotlib.image import imread
from msgspec.structs import replace

from hyperbit.controller.arm.arm import load
from hyperbit.controller.arm.description import density, description, drawing
from hyperbit.controller.panel.arms.drawing import Drawing, cloud, picture
from hyperbit.controller.workspace.mapping import map_densities
from tests.keys import DEPLOY


@pytest.mark.parametrize("name", ["planar16", "platform8", "motor12"])
def test_arms_are_drawn_as_the_daemon_knows_them(name: str) -> None:
    arm = load(DEPLOY / f"{name}.yaml")
    m = arm.manipulator
    drawn = Drawing(replace(description(arm), drawing=drawing(arm)))
    rng = np.random.default_rng(1)
    configuration = rng.integers(0, m.states)
    wanted = m.body(configuration)[:, :, : m.dimension].ravel()
    states = m.actuator_states(configuration).tolist()
    np.testing.assert_allclose(drawn.of_actuators(states), wanted, atol=1e-4 * m.length)
    assert sum(drawn.lines) == len(m.body(configuration))
    text = drawn.of_text(",".join(map(str, configuration)) if m.states.max() > 10 else "".join(map(str, configuration)))
    assert text == drawn.of_actuators(states)
    assert drawn.of_text("9" * 3) is None
    assert drawn.of_actuators([None] * len(states)) is None
    assert drawn.of_actuators([None] * len(states), states) == text
    assert drawn.unknown_modules(states) == []
    first = [None if m.actuators[k].startswith("1.") else state for k, state in enumerate(states)]
    assert drawn.of_actuators(first, states) == text
    assert drawn.unknown_modules(first) == [0]


def test_densities_are_pictures_in_the_plane_and_clouds_in_space() -> None:
    arm = load(DEPLOY / "planar16.yaml")
    told = density(map_densities(arm.manipulator, arm.manipulator.length / 40, 10_000), planar=True)
    pixels = imread(io.BytesIO(picture(told)), format="png")
    assert pixels.shape[:2] == tuple(told.shape[1:])
    opacity = pixels[..., -1]
    assert opacity.min() == 0.0
    assert 0.4 < opacity.max() < 0.8
    arm = load(DEPLOY / "platform8.yaml")
    densities = map_densities(arm.manipulator, arm.manipulator.length / 40, 10_000)
    points = np.array(cloud(density(densities, planar=False)))
    assert 100 < len(points) <= 4000
    low, high = densities.box(0)
    assert (points[:, :3] >= low - 1e-3).all()
    assert (points[:, :3] <= high + 1e-3).all()
