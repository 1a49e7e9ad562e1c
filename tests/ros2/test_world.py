"""Random lives of the bridge with bad input of all kinds, judged; `python -m tests.ros2.world` makes longer ones."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.ros2.world.world import World

pytestmark = pytest.mark.timeout(300)
MOST_ENTRIES = 20_000  # in all tables of the bridge; the description of the arm has 4,600


def test_no_input_harms_the_bridge(tmp_path: Path) -> None:
    world = World(tmp_path, 1)
    world.run(1500)
    assert world.counts["dropped"] > 100
    assert world.judge.accepted > 10
    assert world.largest < MOST_ENTRIES


def replayed(folder: Path) -> str:
    world = World(folder, 0)
    world.run(200)
    return repr((world.chance.random(), world.clock.now, world.network.published, world.counts))


def test_a_seed_replays_exactly_in_another_process(tmp_path: Path) -> None:
    script = "import sys; from pathlib import Path; from tests.ros2.test_world import replayed; "
    command = [sys.executable, "-c", f"{script}print(replayed(Path(sys.argv[1])))", str(tmp_path)]
    environment = {**os.environ, "PYTHONHASHSEED": "1"}
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    (tmp_path / "goals.json").unlink()
    assert done.stdout.strip() == replayed(tmp_path)
