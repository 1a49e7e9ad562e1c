"""The arms in deploy: each file loads and wires all actuators, and the curve of its demo is reachable."""

from pathlib import Path

import numpy as np
import pytest

from hyperbit.controller.arm.arm import Arm, load
from hyperbit.controller.commands.operate.demo import CURVE_WAYPOINTS, closed_curve, sample
from hyperbit.controller.manipulator import frames
from hyperbit.controller.manipulator.manipulator import Manipulator
from hyperbit.controller.search.solver import Solver
from hyperbit.controller.workspace.mapping import map_densities
from tests.keys import DEPLOY

ARMS = {
    "planar16": (2, 16, 48, 16),
    "revolute24": (2, 24, 24, 3),
    "platform8": (3, 8, 48, 8),
    "motor12": (3, 12, 48, 6),
    "valve-islands": (2, 8, 24, 2),
}


@pytest.fixture(scope="module", params=ARMS)
def shipped(request: pytest.FixtureRequest) -> Arm:
    return load(DEPLOY / f"{request.param}.yaml")


def test_no_arm_is_forgotten() -> None:
    assert {path.stem for path in Path(DEPLOY).glob("*.yaml")} == set(ARMS)


def test_an_arm_has_the_name_of_its_file(shipped: Arm) -> None:
    m = shipped.manipulator
    boards = {(entry.bus, entry.node) for entry in shipped.wiring}
    assert (m.dimension, len(m.modules), len(m.actuators), len(boards)) == ARMS[shipped.settings.name]


@pytest.mark.parametrize("method", ["minimum-switch", "ipop-previous", "pop"])
def test_random_tips_and_the_demos_curve_are_reached(shipped: Arm, method) -> None:
    m = shipped.manipulator
    densities = map_densities(m, m.length / 150, 60_000)
    solver, reached = Solver(m, densities), np.zeros(len(m.modules), dtype=np.int64)
    curve = closed_curve(shipped, densities)
    assert curve.shape == (CURVE_WAYPOINTS, m.dimension)
    assert np.ptp(curve, axis=0).max() > 0.05 * m.length
    for goal in (*sample(shipped, 5), *curve[::8]):
        found = solver.solve(solver.target(goal, max(shipped.tolerance, m.length / 200)), reached, method)
        assert found.within_tolerance
        reached = found.configuration


def test_the_curve_moves_with_the_base(shipped: Arm) -> None:
    m = shipped.manipulator
    base = frames.planar(3, -1, 0.5) if m.planar else frames.spatial((1, 2, 3), (0.2, -0.4, 0.1, 0.8))
    moved = Arm(shipped.settings, Manipulator(m.modules, base), shipped.wiring)
    densities = map_densities(m, m.length / 50, 20_000)
    size = m.dimension
    expected = closed_curve(shipped, densities) @ base[:size, :size].T + base[:size, 3]
    np.testing.assert_allclose(closed_curve(moved, densities), expected, atol=1e-9)


def test_an_arm_of_few_configurations_circles_one_of_its_tips(read) -> None:
    joint = {"type": "revolute", "angles": [-0.4, 0.5], "link": {"position": [0, 1]}, "count": 3}
    arm = read({"name": "few", "modules": [joint], "tolerance": {"position": 0.01}})
    curve = closed_curve(arm, map_densities(arm.manipulator, arm.pixel, arm.level_pixels))
    tips = arm.manipulator.tips(np.indices((2, 2, 2)).reshape(3, -1).T)[:, :2, 3]
    nearest = np.linalg.norm(curve[:, None] - tips, axis=2).min(axis=1)
    assert nearest.max() <= arm.tolerance
