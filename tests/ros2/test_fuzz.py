"""Bad input of all kinds, some thousand messages; `python -m tests.ros2.fuzz` sends a million."""

import contextlib
import json
import random
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from hyperbit.controller.ros2.wire import tokens
from tests.ros2.fuzz.inputs import KINDS, Input, Inputs
from tests.ros2.fuzz.world import World
from tests.ros2.judge.reader import Arm, Invalid, goal_of

pytestmark = pytest.mark.timeout(300)
MOST_ENTRIES = 20_000  # in all tables of the bridge; the description of the arm has 4,600
ARM = Arm(("world",), ("tip_x", "tip_y"), ("1.left",), oriented=False)


def test_no_input_harms_the_bridge(tmp_path: Path) -> None:
    world = World(Inputs(random.Random(1)), tmp_path)
    world.run(1500)
    assert world.counts["dropped"] > 100
    assert world.counts["goal"] > 20
    assert sum(it.accepted for it in world.judge.actions.values()) > 10
    assert world.largest < MOST_ENTRIES


@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.lists(st.tuples(st.sampled_from(sorted(KINDS)), st.binary(max_size=200)), min_size=1, max_size=20))
def test_any_bytes_are_dropped_told_or_answered(world: World, given: list[tuple[str, bytes]]) -> None:
    attachment = (1).to_bytes(8, "little") + bytes(8) + b"\x10" + bytes(16)
    with world.in_place():
        for name, data in given:
            world.deliver(Input(name, b"\x00\x01\x00\x00" + data, attachment))
            world.run_jobs()


@settings(max_examples=100, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
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
def test_whatever_is_on_the_daemons_keys_keeps_the_node(world: World, key: str, data: bytes) -> None:
    tokens_before = set(world.network.tokens)
    with world.in_place():
        world.hear(key, data)
    assert world.network.tokens == tokens_before


@pytest.fixture(scope="module")
def world(tmp_path_factory: pytest.TempPathFactory) -> Any:
    world = World(Inputs(random.Random(0)), tmp_path_factory.mktemp("fuzz"))
    world.run(1)
    world.reopen()
    return world


@given(st.text(max_size=300) | st.lists(st.text(max_size=5), max_size=14).map("/".join))
def test_tokens_of_strangers_are_tokens_or_refused(text: str) -> None:
    with contextlib.suppress(tokens.BadToken):  # another error is a failure
        assert tokens.parse("@ros2_lv/" + text).text


def test_the_reader_refuses_what_is_no_message() -> None:
    for message in (b"", b"\x00\x01\x00\x00", b"\x00\x01\x00\x00" + b"\xff" * 80, bytes(1_000_001)):
        for kind in ("goal_pose", "goal_path", "setpoint", "plan", "tip", "actuators"):
            with pytest.raises(Invalid):
                goal_of(kind, message, ARM, 0.0)
