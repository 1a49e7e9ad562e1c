"""Arms of other modules through the whole daemon: what their boards are told, and where the tip then is."""

from typing import Any

import numpy as np
import pytest
import yaml

from controller.config import Arm, load
from controller.workspace.densities import Densities
from controller.workspace.mapping import map_densities
from drivers.simulation.simulation import Simulation
from tests.integration.harness import Observer
from tests.test_chain import PLATFORM

HALF = 0.70710678
MOTOR = {
    "type": "revolute",
    "count": 4,
    "axis": [1, 0, 0],
    "angles": [-0.5, -0.3, -0.1, 0.1, 0.3],
    "link": {"position": [0, 0, 0.15], "orientation": [0, 0, HALF, HALF]},
}
SLIDE = {"type": "prismatic", "axis": [0, 0, 1], "lengths": [0.1, 0.15, 0.2, 0.25]}
GRIPPER = {"type": "transforms", "table": "gripper.csv"}
TABLE = "x,y,z,qx,qy,qz,qw\n0,0,0.05,0,0,0,1\n0.02,0,0.045,0,0.1,0,0.995\n"
BOARDS = [[1, 2], [3, 4, 5], [6], [7]]  # the modules of each board


@pytest.fixture(scope="session")
def arm(tmp_path_factory: pytest.TempPathFactory) -> Arm:
    """Four motors of five positions, a slide, a platform and a measured gripper, on boards of twelve bits at most."""
    folder = tmp_path_factory.mktemp("mixed")
    bits = [3, 3, 3, 3, 2, 6, 1]
    actuators: list[dict[str, Any]] = []
    for node, modules in enumerate(BOARDS, 1):
        wired = [(m, str(k + 1)) for m in modules for k in range(bits[m - 1])]
        actuators += [
            {"module": m, "actuator": name, "bus": "can0", "node": node, "output": bit, "input": bit}
            for bit, (m, name) in enumerate(wired)
        ]
    described = {
        "name": "mixed",
        "modules": [MOTOR, SLIDE, PLATFORM, GRIPPER],
        "tolerance": {"position": 0.01},
        "buses": [{"name": "can0", "channel": "can0"}],
        "actuators": actuators,
    }
    (folder / "gripper.csv").write_text(TABLE)
    (folder / "arm.yaml").write_text(yaml.safe_dump(described))
    return load(folder / "arm.yaml")


@pytest.fixture(scope="session")
def densities(arm: Arm) -> Densities:
    return map_densities(arm.manipulator, arm.manipulator.length / 60, 40_000)


def test_goals_in_space_are_reached_by_the_boards(client: Observer, boards: Simulation, arm: Arm) -> None:
    m = arm.manipulator
    drawn = np.random.default_rng(5).integers(0, m.states, (3, len(m.states)))
    goals = m.tips(drawn)[:, :3, 3]
    for k, goal in enumerate(goals):
        result = client.move(tuple(goal.tolist()), goal=f"goal {k}")
        tip = m.tip(m.configuration(boards.positions().astype(np.uint8)))
        assert np.linalg.norm(tip[:3, 3] - goal) <= arm.tolerance
        assert result["position"] == pytest.approx(tip[:3, 3])
    assert client.ask("arm")["frames"] == [module.frames.tolist() for module in m.modules]
