"""Random lives of the bridge with bad input of all kinds, judged; `python -m tests.ros2.world` makes longer ones."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tests.ros2.rig import Rig
from tests.ros2.world.inputs import KINDS, Input
from tests.ros2.world.world import World

pytestmark = pytest.mark.timeout(300)
MOST_ENTRIES = 20_000  # in all tables of the bridge; the description of the arm has 4,600
QUIETLY = settings(suppress_health_check=[HealthCheck.function_scoped_fixture])


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


@QUIETLY
@given(st.lists(st.tuples(st.sampled_from(sorted(KINDS)), st.binary(max_size=200)), min_size=1, max_size=20))
def test_any_bytes_are_dropped_or_answered(rig: Rig, given: list[tuple[str, bytes]]) -> None:
    for name, data in given:
        rig.deliver(Input(name, b"\x00\x01\x00\x00" + data))
        rig.threads.run()


@QUIETLY
@given(
    st.sampled_from(["arm", "state", "result", "feedback", "diagnostics", "alive", "gone", "other"]),
    st.one_of(
        st.binary(max_size=100),
        st.recursive(
            st.none() | st.booleans() | st.floats() | st.integers() | st.text(),
            lambda inner: st.lists(inner) | st.dictionaries(st.sampled_from(["id", "stamp", "mode", "faults"]), inner),
            max_leaves=10,
        ).map(lambda value: json.dumps(value).encode()),
    ),
)
def test_whatever_is_on_the_daemons_keys_keeps_the_node(rig: Rig, key: str, data: bytes) -> None:
    before = set(rig.network.tokens)
    rig.hear(key, data, sure=False)
    assert rig.network.tokens == before
