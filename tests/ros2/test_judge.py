"""The judge finds nothing wrong with the bridge."""

import os
import random
import subprocess
import sys
from pathlib import Path

import pytest

from hyperbit.controller.ros2 import goals
from tests.ros2.fuzz.inputs import Inputs
from tests.ros2.fuzz.world import World
from tests.ros2.judge import judge

pytestmark = pytest.mark.timeout(600)


def test_the_judge_finds_nothing_if_clients_lose_their_goals_more_often(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for room in (goals, judge):
        monkeypatch.setattr(room, "GONE_AFTER", 0.5)
    World(Inputs(random.Random(1)), tmp_path).run(1_500)


def replayed(folder: Path) -> str:
    world = World(Inputs(random.Random(0)), folder)
    world.run(300)
    return repr((world.chance.random(), world.clock.now, world.network.words, world.counts))


def test_a_seed_replays_exactly_in_another_process(tmp_path: Path) -> None:
    script = "import sys; from pathlib import Path; from tests.ros2.test_judge import replayed as it; "
    command = [sys.executable, "-c", f"{script}print(it(Path(sys.argv[1])))", str(tmp_path / "other")]
    environment = {**os.environ, "PYTHONHASHSEED": "1"}
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    assert done.stdout.strip() == replayed(tmp_path / "own")
