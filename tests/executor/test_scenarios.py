"""Plays the scenarios: `core` on a master without boards, `boards` on the real CANopen master and simulated boards."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.executor.play import Play
from tests.executor.rig import Rig, World
from tests.executor.scenario import Scenario, read

FOLDER = Path(__file__).parent / "scenarios"
CASES = [
    pytest.param(path, scenario, id=f"{path.stem}: {scenario.title} {'; '.join(scenario.arm)}".rstrip())
    for path in sorted(FOLDER.glob("*.txt"))
    for scenario in read(path)
]


@pytest.mark.parametrize(("path", "scenario"), CASES)
def test_scenario(path: Path, scenario: Scenario) -> None:
    Play(scenario, World if path.stem.endswith("on_boards") else Rig).run(path)
