"""A short run on targets with states, and all inputs that once caused a failure."""

from __future__ import annotations

import logging
from collections.abc import Iterator

import pytest
from hypothesis import HealthCheck, given, settings

from hyperbit.controller.host.process import Log
from hyperbit.controller.program import Setpoint, pack
from hyperbit.drivers.canopen.wire import cia301
from hyperbit.drivers.canopen.wire.cia301 import Frame
from tests.fuzz.frames import KNOWN, Boards, act
from tests.fuzz.judge import Flood, Moved
from tests.fuzz.readers import MOST_LINES, SAMPLES, Quiet
from tests.fuzz.targets import TARGETS
from tests.fuzz.world import World

MUTATIONS = 100  # of each reader; `make fuzz` runs 20,000


@pytest.fixture(autouse=True)
def _journal() -> Iterator[None]:
    root = logging.getLogger()
    handlers, level = list(root.handlers), root.level
    yield
    root.handlers[:] = handlers
    root.setLevel(level)


@pytest.mark.parametrize("name", TARGETS)
def test_seeds_and_former_failures(name):
    target = TARGETS[name]
    attack = target.build()
    for data in target.seeds + target.found(name):
        attack(data)


@pytest.mark.parametrize(
    ("name", "examples"),
    [("executor", 15), ("packets", 15), ("board", 100), ("arm", 40), ("obstacles", 100), ("recording", 20)],
)
def test_hypothesis_finds_nothing(name, examples):
    attack = TARGETS[name].build()

    @settings(max_examples=examples, suppress_health_check=[HealthCheck.too_slow])
    @given(TARGETS[name].strategy)
    def run(data):
        attack(data)

    run()


@pytest.mark.parametrize("name", SAMPLES)
def test_mutations_end_no_reader(name):
    target = TARGETS[name]
    attack = target.build()
    for number in range(MUTATIONS):
        attack(target.mutation(name, number))


def test_a_traceback_and_a_flood_of_lines_are_found():
    log = logging.getLogger("reader")

    def take(key, data):
        log.warning("%s cannot be read", key, exc_info=ValueError("odd") if data == b"odd" else None)

    with pytest.raises(AssertionError, match="ValueError: odd"):
        Quiet(take, starts=False)(b"state\nodd")
    attack = Quiet(take, starts=False)
    for _ in range(MOST_LINES):
        attack(b"state\n{}")
    with pytest.raises(Flood, match="the last: state cannot be read"):
        attack(b"state\n{}")


def test_a_frame_that_no_goal_asks_for_is_found():
    world = World()
    with pytest.raises(Moved, match="080h  was sent in mode ready without a goal"):
        world.judge.judge(Frame(cia301.SYNC), world.core, lambda node: 0)


def test_states_that_no_goal_asks_for_are_found():
    world = World()
    world.program(0b000001)
    world.judge.judge(Frame(cia301.RPDO1 + 5, bytes([0b000011])), world.core, lambda node: 0)
    with pytest.raises(Moved, match=r"000011 was switched, \['000001'\] are asked for"):
        world.judge.judge(Frame(cia301.SYNC), world.core, lambda node: 0)


def test_outputs_that_differ_from_the_command_are_found():
    world = World()
    world.boards.board("can0/5").wired[0].actuator.drive(1, world.now)
    with pytest.raises(Moved, match="the outputs are 000001, switched to 000000"):
        world.check_outputs()


def test_a_line_a_frame_is_found(monkeypatch):
    attack = Boards()
    step = attack.world.core.step
    monkeypatch.setattr(attack.world.core, "step", lambda event, now: [*step(event, now), Log(logging.INFO, "told")])
    with pytest.raises(Flood):
        attack(act(KNOWN, 3, 8) * 100)


def test_programs_and_setpoints_are_carried_out_in_between():
    attack = Boards()
    assert attack(act(0xF4, 0, 3, b"\1\2\4\3\5\6") + act(0xF0, 0x0F0B) * 4) == 0
    assert attack.syncs == 4
    world = attack.world
    assert world.core.modes.mode == "ready"
    number, epoch = world.core.requests.greatest + 1, world.core.modes.epoch
    start, stages = pack(world.master.outputs, 6), (pack(0b111000, 6),)
    world.send(Setpoint(number, epoch, start, stages, world.now + 1.0, False, "following"))
    world.go(3)
    assert world.boards.drives() == [0, 0, 0, 1, 1, 1]
    assert world.core.modes.mode == "executing"
    world.recover()
