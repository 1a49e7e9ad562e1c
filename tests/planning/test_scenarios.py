"""Plays the scenarios of the planner's core."""

from __future__ import annotations

from pathlib import Path

import pytest

from hyperbit.controller.arm.arm import Arm
from hyperbit.controller.workspace.densities import Densities
from tests.planning.conftest import SIMULATION
from tests.planning.rig.desk import Desk
from tests.planning.rig.play import Play
from tests.scenario import Scenario, cases


@pytest.mark.parametrize(("path", "scenario"), cases(Path(__file__).parent / "scenarios"))
def test_scenario(path: Path, scenario: Scenario, small: Arm, small_densities: Densities) -> None:
    desk = Desk(small, small_densities, simulation=SIMULATION if "simulated" in scenario.settings else None)
    desk.executor.greet()
    Play(scenario, desk).run(path)
