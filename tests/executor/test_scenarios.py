"""Plays the scenarios: those on boards on the real CANopen master, the others on a master without boards."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.executor.play import Play
from tests.executor.rig import Rig, World
from tests.scenario import Scenario, cases


@pytest.mark.parametrize(("path", "scenario"), cases(Path(__file__).parent / "scenarios"))
def test_scenario(path: Path, scenario: Scenario) -> None:
    Play(scenario, World if path.stem.endswith("on_boards") else Rig).run(path)
