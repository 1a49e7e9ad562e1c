"""A short attack on what has states, and every input that something once went wrong with."""

from __future__ import annotations

import logging
from collections.abc import Iterator

import can
import pytest
from hypothesis import HealthCheck, given, settings

from drivers import cia301
from drivers.boards import Boards
from tests.fuzz.frames import KNOWN, act
from tests.fuzz.targets import TARGETS
from tests.fuzz.world import Flood, Moved, World


@pytest.fixture(autouse=True)
def _journal() -> Iterator[None]:
    root = logging.getLogger()
    handlers, level = list(root.handlers), root.level
    yield
    root.handlers[:] = handlers
    root.setLevel(level)


@pytest.mark.parametrize("name", TARGETS)
def test_seeds_and_what_was_found(name):
    target = TARGETS[name]
    attack = target.build()
    for data in target.seeds + target.found(name):
        attack(data)


@pytest.mark.parametrize(("name", "examples"), [("daemon", 60), ("board", 300), ("arm", 100), ("obstacles", 300)])
def test_hypothesis_finds_nothing(name, examples):
    attack = TARGETS[name].build()

    @settings(max_examples=examples, suppress_health_check=[HealthCheck.too_slow])
    @given(TARGETS[name].strategy)
    def run(data):
        attack(data)

    run()


# --- what would be found


def test_a_frame_that_no_goal_asks_for_is_found(monkeypatch):
    attack = TARGETS["daemon"].build()
    boards = attack.world.boards
    monkeypatch.setattr(boards, "hold", lambda: attack.world.can.send(cia301.frame(cia301.SYNC)))
    with pytest.raises(Moved, match="080h  was sent in mode starting without a goal"):
        attack(act(0xF6, 1) + act(0xF7))


def test_outputs_that_differ_from_what_was_switched_are_found():
    world = World()
    world.simulation.board("can0/5").wired[0].actuator.drive(1, world.now)
    with pytest.raises(Moved, match=r"the outputs are \[1, 0, 0, 0, 0, 0\], switched to \[0, 0"):
        world.check_outputs()


def test_a_line_a_frame_is_found(monkeypatch):
    attack = TARGETS["daemon"].build()
    receive = attack.world.can._receive

    def tell(message: can.Message) -> None:
        logging.getLogger("test").warning("%s", message)
        receive(message)

    monkeypatch.setattr(attack.world.can, "_receive", tell)
    with pytest.raises(Flood):
        attack(act(KNOWN, 3, 8) * 100)


def test_a_goal_is_carried_out_in_between(monkeypatch):
    commits = []
    commit = Boards.commit
    monkeypatch.setattr(Boards, "commit", lambda self, states, now: (commits.append(1), commit(self, states, now)))
    attack = TARGETS["daemon"].build()
    assert attack(act(0xF4, 0, 3, b"\1\2\3\4\5\6") + act(0xF0, 0x0F0B) * 4) == 0
    assert attack.syncs == 4
    assert attack.world.loop.mode == "ready"
    assert attack.world.drives().tolist() == attack.world.boards.outputs().tolist()
    assert len(commits) == 4
